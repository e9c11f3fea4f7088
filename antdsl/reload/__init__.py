"""An edited program goes on from where the old one stands.

`take_over` binds the edited plan to the setting (`migrate`), which gives a new world, and reads the old one, which is never
changed: an error leaves it as it was. Agents keep their rows, attributes and states where a name still means the same
(`agents`); they stand where they stood, or at the nearest place of a ground that changed (`footing`). What was kept, moved and
begun anew is said in one line (`summary`)."""

from antdsl.reload.migrate import Migration, migration_line, take_over

__all__ = ["Migration", "migration_line", "take_over"]
