"""The command ``submaps``: serve, replay, plot, export, evaluate, experiment."""

from __future__ import annotations

import sys

import typer

from service.client import Refused, Unreachable
from service.commands.console import FAULT, INPUT, INTERRUPTED, REFUSED, UNREACHABLE, fail
from service.commands.evaluate import evaluate
from service.commands.experiment import experiment
from service.commands.export import export
from service.commands.plot import plot
from service.commands.replay import replay
from service.commands.serve import serve
from service.datasets import DatasetError
from service.standalone import NotStarted
from submaps.errors import NumericalError

app = typer.Typer(
    name="submaps",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Large-scale SLAM as a service: bounded sub-maps, joined, with covariances.",
    epilog="Exit codes: 0 done, 1 fault, 2 wrong input, 3 no service answers, 4 the service refused.",
)
for command in (serve, replay, plot, export, evaluate, experiment):
    app.command()(command)


def main() -> None:
    """Entry point: run a command, and turn what may go wrong into a message and an exit code."""
    try:
        app()
    except DatasetError as error:
        fail(str(error), INPUT)
    except Unreachable as error:
        fail(str(error), UNREACHABLE)
    except Refused as error:
        hint = "; choose another name with --map" if error.status == 409 and "exists" in error.type else ""
        fail(f"the service refused: {error}{hint}", REFUSED)
    except (NotStarted, NumericalError) as error:
        fail(str(error), FAULT)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
