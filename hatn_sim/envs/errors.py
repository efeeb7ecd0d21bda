"""What can go wrong with an environment: an exception type each.

Those that gymnasium has a type for are of that type, too.
"""

from __future__ import annotations

import re
from typing import Final

import gymnasium

from hatn_sim.errors import InputError

_VALUES: Final = re.compile(r"--(\w+) (module:Class|FILE)")
_FLAGS: Final = re.compile(r"--(\w+)")


def in_python(said: object) -> str:
    """What is said to users of commands, for those of environments: options have no dashes."""
    return _FLAGS.sub(r"\1", _VALUES.sub(r"\1='\2'", str(said)))


class OptionError(InputError):
    """An option is unknown, of the wrong type or out of its range, or does not go with another."""


class NeedsResetError(InputError, gymnasium.error.ResetNeeded):
    """`step` or `render` without an episode: before `reset`, or after `close`."""


class EpisodeOverError(NeedsResetError):
    """`step` after the end of the episode."""


class ActionError(InputError, gymnasium.error.InvalidAction):
    """An action is not of the action space."""


class ActionTypeError(ActionError):
    """It is not of the type of the form of action chosen."""


class ActionShapeError(ActionError):
    """It has not the shape of the action space."""


class ActionRangeError(ActionError):
    """It is out of bounds, or no finite number."""


class MaskedActionError(ActionError):
    """The slot is not there to be chosen now."""


class EgoError(InputError):
    """The ego never comes."""


class RenderError(InputError):
    """What was asked for cannot be shown."""


class MissingPackageError(InputError, ImportError):
    """An extra of this package is needed that is not installed."""
