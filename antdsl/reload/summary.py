"""What was kept, moved and begun anew when an edited program took over, in one line."""

from __future__ import annotations

from antdsl.reload.agents import MigratedSpecies
from antdsl.reload.migrate import Migration


def migration_line(migration: Migration) -> str:
    """Such as "kept 500 agents · 12 of removed state `dig` begin anew in `search` · `load` is new"."""
    parts = [f"kept {migration.agents:,} {_agents(migration.agents)}"]
    several = len(migration.species) > 1
    for migrated in migration.species:
        parts += _species(migrated, f"{migrated.species}." if several else "")
    parts += [f"{count:,} more of `{name}`" for name, count in migration.joined.items()]
    parts += [f"{count:,} of `{name}` gone" for name, count in migration.removed.items()]
    parts += _listed(migration.items, "has its amount from the scene", "have their amounts from the scene")
    parts += _listed([f"field {name}" for name in migration.fields], "starts again", "start again")
    parts += _listed([f"solid {name}" for name in migration.solids], "is whole", "are whole")
    return " · ".join(parts)


def _species(migrated: MigratedSpecies, of: str) -> list[str]:
    parts = [
        f"{count:,} of removed state `{of}{_plain(gone)}` {'starts' if count == 1 else 'start'} again in `{of}{_plain(start)}`"
        for (gone, start), count in sorted(migrated.begun.items())
    ]
    parts += _listed([of + _plain(name) for name in migrated.states], "is a new state", "are new states")
    parts += _listed([of + _plain(name) for name in migrated.lost], "is a state no more", "are states no more")
    if migrated.moved:
        parts.append(
            f"{migrated.moved:,} {_agents(migrated.moved)} moved with the ground" + (f" of `{migrated.species}`" if of else "")
        )
    parts += _listed([of + name for name in migrated.new], "is new", "are new")
    parts += _listed(
        [of + name for name in migrated.other], "has another type and starts again", "have other types and start again"
    )
    parts += _listed([of + name for name in _written(migrated.rewritten)], "is as written now", "are as written now")
    parts += _listed([of + name for name in migrated.gone], "is gone", "are gone")
    if migrated.forgotten:
        parts.append(f"{migrated.forgotten} {'memory' if migrated.forgotten == 1 else 'memories'} forgotten")
    return parts


def _written(names: list[str]) -> list[str]:
    """Less those that follow from others, and are seldom written: strength from speed, radius from size."""
    follow = {"max_force": {"mass", "max_speed", "response"}, "radius": {"size"}}
    return [name for name in names if not follow.get(name, set()) & set(names)]


def _plain(state: str) -> str:
    """Most species have one machine, which nobody named."""
    return state.removeprefix("main.")


def _agents(count: int) -> str:
    return "agent" if count == 1 else "agents"


def _listed(names: list[str], one: str, several: str) -> list[str]:
    if not names:
        return []
    shown = ", ".join(f"`{name}`" for name in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return [f"{shown} {one if len(names) == 1 else several}"]
