"""An edited program continues from the state of the old one.

`take_over` binds the edited plan to the setting (`migrate`), which gives a new world, and reads the old one, which never changes:
an error leaves it as it was. Agents retain their rows, attributes and states where a name still means the same (`agents`). They
stay at their positions, or move to the nearest position of a ground that changed (`footing`). One line says what was retained,
moved and reset (`summary`)."""

from antdsl.reload.migrate import Migration, migration_line, take_over

__all__ = ["Migration", "migration_line", "take_over"]
