"""`hatn-sim`: the command line. Errors a user can mend are one line on stderr, without a traceback.

Exit codes: 0 done, 1 the simulator or the machine failed, 2 something handed in is wrong,
130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, Final, NoReturn

import hatn_sim
from hatn_sim.errors import HatnSimError, nearest

VERBS: Final = {
    "run": "simulate a scene, predict every vehicle, leave a log, scores and a picture",
    "score": "print the scores of one or more runs again, pooled",
    "report": "draw a picture and an animation of a run",
    "figures": "draw figures for papers, of runs or of tables: PDF, SVG and PNG",
    "animate": "make a film of a stretch of a run, MP4 or GIF",
    "export": "write a run as INTERACTION tracks, SUMO floating car data or for Rerun",
    "assess": "judge alerts and suggestions over many runs by what really happened",
    "evaluate": "score predictors on many runs side by side, and print the tables of the paper",
    "compare": "drive vehicles by an agent with several predictors: which of them drives best?",
    "net": "build a SUMO net from a Lanelet2 map or another map, in the map's own frame",
    "train": "train HATN on simulated or recorded traffic and write its weights",
    "train-policy": "train a policy that drives, PPO or DQN, and write its weights",
    "scenarios": "list the scenes that ship, with their measured figures",
    "check-predictor": "check a predictor or an agent of your own against the protocols",
    "doctor": "say what is installed, what is missing and how to get it",
    "bench": "time every stage of a tick side by side, and the memory it takes",
}


class _Parser(argparse.ArgumentParser):
    """argparse with this project's kind of error: one line that says what to do."""

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Any = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As argparse does it, but that an unknown option is an error that names the nearest."""
        found, unknown = super().parse_known_args(args, namespace)
        for word in unknown:
            name = word.partition("=")[0]
            close = difflib.get_close_matches(name, self._option_string_actions, n=1)
            if name.startswith("--"):
                meant = f"; did you mean {close[0]}?" if close else ""
                self.error(f"unknown option {name}{meant}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        print(f"hatn-sim: {message}; see `{self.prog} --help`", file=sys.stderr)
        raise SystemExit(2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        parser = _make_parser(words)
        parsed = parser.parse_args(words)
        if parsed.verb is None:
            parser.print_help()
            return 0
        code: int = _command(parsed.verb).main(parsed)
        sys.stdout.flush()
        return code
    except HatnSimError as error:
        print(f"hatn-sim: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("hatn-sim: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Nobody reads on (`| head`); what Python would still flush at its end goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _command(verb: str) -> Any:
    """The module of a verb."""
    return import_module(f"hatn_sim.commands.{verb.replace('-', '_')}")


def _make_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="hatn-sim",
        description="Traffic simulation in which HATN predicts, for every vehicle and at every "
        "tenth of a second, the slot it will take and its path for the next three seconds.",
        epilog="Begin with: hatn-sim run intersection5",
    )
    parser.add_argument("--version", action="version", version=hatn_sim.__version__)
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", parser_class=_Parser)
    asked = next((word for word in words if not word.startswith("-")), None)
    if asked is not None and asked not in VERBS:
        parser.error(f"unknown verb {asked!r}{nearest(asked, VERBS)}")
    for verb, purpose in VERBS.items():
        module = _command(verb)
        child = verbs.add_parser(
            verb,
            help=purpose,
            description=module.__doc__,
            epilog=getattr(module, "EXAMPLES", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,  # --predictor is no --predictors
        )
        if verb == asked:
            module.add_arguments(child)
    return parser


if __name__ == "__main__":
    sys.exit(main())
