"""Migration: an edited program continues from the state of the running one.

`migrate_world` (in `migrate`) binds the edited plan to the setting, and copies the state of the old world into the new one. The
old world never changes, so it remains usable after an error. Agents stay in their rows. Their attributes and states are retained
if they have the same name and meaning in both programs (`agents`). Agents stay at their positions, or move to the nearest
position on ground that has changed (`footing`). `describe_migration` says in one line what was retained, moved and reset."""

from antdsl.reload.migrate import Migration, describe_migration, migrate_world

__all__ = ["Migration", "describe_migration", "migrate_world"]
