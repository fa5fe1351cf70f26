"""`ChargingEnv` as Gymnasium environments: one highway, or many of them in one compiled program.

Importing this module registers both as `medjax/Charging-v0`. So does `import medjax` if Gymnasium is already imported:

    import gymnasium
    import medjax.wrappers.gymnasium

    env = gymnasium.make("medjax/Charging-v0", scenario="paper", cooldown_s=30)
    envs = gymnasium.make_vec("medjax/Charging-v0", num_envs=256)

`gymnasium.make("medjax.wrappers.gymnasium:medjax/Charging-v0")` needs no import. Arguments are those of `medjax.make`,
or `env` and `params` for an existing environment, and `decide_every`. Episodes are truncated after `episode_decisions`,
so `max_episode_steps` is not needed. Results are NumPy arrays that the caller may keep or change.
"""

from medjax.hooks import ENV_ID, register
from medjax.wrappers.gymnasium.single import ChargingGymEnv
from medjax.wrappers.gymnasium.vector import ChargingVectorEnv

__all__ = ["ENV_ID", "ChargingGymEnv", "ChargingVectorEnv"]

register()
