"""Commands by their names: a wrong one is told as every other mistake is."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

from gpusim.config.names import perhaps
from gpusim.errors import UserError


class Commands(TyperGroup):
    """A group of commands that tells the nearest name where one is wrong."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command and its arguments.

        Raises
        ------
        UserError
            There is no such command.
        """
        name = args[0]
        if not (ctx.resilient_parsing or name.startswith("-") or name in self.commands):
            raise UserError(
                f"no such command{perhaps(name, self.commands)}",
                field=ctx.command_path,
                value=name,
                allowed=", ".join(self.commands),
            )
        return super().resolve_command(ctx, args)
