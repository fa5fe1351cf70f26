"""`ChargingEnv` as Gymnasium environments: one highway, or many of them in one compiled program.

`import medjax` registers both as `medjax/Charging-v0` where Gymnasium is installed:

    import gymnasium
    import medjax

    env = gymnasium.make("medjax/Charging-v0", scenario="paper", cooldown_s=30)
    envs = gymnasium.make_vec("medjax/Charging-v0", num_envs=256)

`gymnasium.make("medjax:medjax/Charging-v0")` imports it by itself. Arguments are those of
`medjax.make`. Episodes are truncated after `episode_decisions`: no `max_episode_steps` is needed. NumPy arrays come
out, and are the caller's to keep or to change.
"""

from medjax.wrappers.gymnasium.single import ENV_ID, ChargingGymEnv
from medjax.wrappers.gymnasium.vector import ChargingVectorEnv

__all__ = ["ENV_ID", "ChargingGymEnv", "ChargingVectorEnv"]
