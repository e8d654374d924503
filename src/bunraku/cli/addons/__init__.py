"""Add-ons of other programs, written as files and folders."""
