"""`ChargingEnv` as Gymnasium environments: one highway, or many of them in one compiled program.

Importing this registers both as `medjax/Charging-v0`, as `import medjax` does after Gymnasium:

    import gymnasium
    import medjax.wrappers.gymnasium

    env = gymnasium.make("medjax/Charging-v0", scenario="paper", cooldown_s=30)
    envs = gymnasium.make_vec("medjax/Charging-v0", num_envs=256)

`gymnasium.make("medjax.wrappers.gymnasium:medjax/Charging-v0")` needs no import, and no order. Arguments are those of
`medjax.make`, or `env` and `params`, an environment of one's own; and `decide_every`. Episodes are truncated after
`episode_decisions`: no `max_episode_steps` is needed. NumPy arrays come out, and are the caller's to keep or to change.
"""

from medjax.hooks import ENV_ID, register
from medjax.wrappers.gymnasium.single import ChargingGymEnv
from medjax.wrappers.gymnasium.vector import ChargingVectorEnv

__all__ = ["ENV_ID", "ChargingGymEnv", "ChargingVectorEnv"]

register()
