"""What other programs can call: tools in one folder, by the Model Context Protocol."""
