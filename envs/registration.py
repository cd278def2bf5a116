"""The ids of the tasks in Gymnasium: importing this module registers them.

    import envs.registration
    gymnasium.make("gearlash/BacklashPosition-v0")
    gymnasium.make_vec("gearlash/BacklashPosition-v0", 64, vectorization_mode="vector_entry_point")

or, in one line, `gymnasium.make("envs.registration:gearlash/BacklashPosition-v0")`.
"""

from __future__ import annotations

import gymnasium

from envs.task import TASKS

# Name of a task -> its id.
IDS = {name: f"gearlash/{task.__name__}-v0" for name, task in TASKS.all().items()}

for _name, _id in IDS.items():
    gymnasium.register(
        _id,
        entry_point="envs.single:SingleEnv",
        vector_entry_point="envs.vector:BatchedEnv",
        kwargs={"task": _name},
    )
