"""The errors that a user can cause: each one line, what is wrong and what would be right."""


class UserError(Exception):
    """Something the user gave is wrong; the command line prints it and ends with status 2."""


class BagError(UserError):
    """A bag or table cannot be read, or does not hold what is asked of it."""


class ModelError(UserError):
    """A model file is damaged, or does not fit the plant."""


class DataError(UserError):
    """The samples do not allow what is asked: too few, constant, not finite."""


class WorkerError(UserError):
    """A worker process ended unexpectedly, for example killed because memory ran out."""
