"""Mistakes to plant in a method: each is given the right one, and returns a wrong one."""

from collections.abc import Callable


def of_other(change: Callable) -> Callable:
    """A method that is called with other arguments: `change` returns them."""
    return lambda right: lambda self, *args: right(self, *change(*args))


def gives_other(change: Callable) -> Callable:
    """A method whose result is another: `change` of the object, its result and its arguments."""
    return lambda right: lambda self, *args: change(self, right(self, *args), *args)
