"""The command `phipsi completion`."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from .commands import group

#: How to enable completion in each shell.
READ = {
    "bash": 'eval "$(phipsi completion bash)"  in ~/.bashrc',
    "zsh": 'eval "$(phipsi completion zsh)"  in ~/.zshrc',
    "fish": "phipsi completion fish > ~/.config/fish/completions/phipsi.fish",
}


@group.command(epilog="\n\n".join(["\b\n" + "\n".join(READ.values())]))
@click.argument("shell", type=click.Choice(tuple(READ)))
def completion(shell: str) -> None:
    """Print the completion script of a shell for commands, options and file names."""
    of_shell = get_completion_class(shell)
    assert of_shell is not None
    script = of_shell(group, {}, "phipsi", "_PHIPSI_COMPLETE")
    # script.source() would start the shell to determine its version.
    click.echo(script.source_template % script.source_vars())
