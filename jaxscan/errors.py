"""The errors that jaxscan raises on purpose: each text names the file, the value and the mend."""


class JaxscanError(Exception):
    """Whatever jaxscan refuses to do, with the reason and the cure in its text."""


class InputError(JaxscanError):
    """Something that the user gave is wrong: a file, a key, an option, an array's shape."""


class ObservabilityError(InputError):
    """The photographs do not determine what was asked of them."""


class SolveError(JaxscanError):
    """The solve did not reach a minimum."""
