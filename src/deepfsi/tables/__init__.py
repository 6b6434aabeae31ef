"""Arrays and tables from files, each format in one place."""
