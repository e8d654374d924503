"""What a page requests, a dataclass for each form: the same for a request of the page, a link and a project file."""
