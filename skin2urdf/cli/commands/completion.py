"""``skin2urdf completion``: what completes its words in a shell."""

from __future__ import annotations

import argparse
import sys

from skin2urdf.cli.arguments import Parser

HELP = "print what lets a shell complete commands, options and files"
EPILOG = """\
to install it:
  bash  skin2urdf completion bash > ~/.local/share/bash-completion/completions/skin2urdf
  zsh   skin2urdf completion zsh > ~/.zfunc/_skin2urdf
        with `fpath+=~/.zfunc; autoload -Uz compinit; compinit` in ~/.zshrc
  fish  skin2urdf completion fish > ~/.config/fish/completions/skin2urdf.fish

Make the folder first where there is none (mkdir -p). It takes effect in the next shell, which asks
the command itself for what may follow."""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("shell", choices=("bash", "zsh", "fish"), help="for which shell")


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    from argcomplete.shell_integration import shellcode

    sys.stdout.write(shellcode(["skin2urdf"], shell=options.shell))
    return 0


def answer_the_shell(parser: argparse.ArgumentParser) -> None:
    """Tell a shell that asks what may follow its words, and end; return where none asks.

    Args:
        parser: of the whole command line.
    """
    import argcomplete

    from skin2urdf.simulation.robots import robot_names

    for command in commands_of(parser).values():
        for action in command._actions:
            if action.metavar == "ROBOT":
                action.completer = lambda **_: robot_names()  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of all commands, by name."""
    return {
        name: command
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, command in action.choices.items()
    }
