"""The verb that the study adds to the command line."""
