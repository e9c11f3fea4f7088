"""An edited program continues from the state of the running one.

`migrate_world` (in `migrate`) binds the edited plan to the setting, and copies the state of the old world to the new one. The
old world never changes, so it remains usable after an error. Agents retain their rows. They also retain attributes and states
that have the same name and meaning in both programs (`agents`). They stay at their positions, or move to the nearest position of
a ground that changed (`footing`). `describe_migration` describes in one line what was retained, moved and reset."""

from antdsl.reload.migrate import Migration, describe_migration, migrate_world

__all__ = ["Migration", "describe_migration", "migrate_world"]
