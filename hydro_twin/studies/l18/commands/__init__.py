"""The verbs that the study adds to the command line."""
