"""The workbench: everything from commissioning to a cured axis in a browser, by the commands of the command line."""
