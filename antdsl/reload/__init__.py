"""An edited program continues from the state of the running one.

`migrate_world` (in `migrate`) binds the edited plan to the setting and moves the state of the old world into the new one. The old
world never changes, so an error leaves it usable. Agents retain their rows. They also retain attributes and states that have the
same name and meaning in both programs (`agents`). They stay at their positions, or move to the nearest position of a ground that
changed (`footing`). `describe_migration` describes in one line what was retained, moved and reset."""

from antdsl.reload.migrate import Migration, describe_migration, migrate_world

__all__ = ["Migration", "describe_migration", "migrate_world"]
