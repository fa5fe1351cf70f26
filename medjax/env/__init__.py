"""The dispatching problem: reset, decision, reward and observation of one highway."""

from medjax.env.charging_env import ChargingEnv

__all__ = ["ChargingEnv"]
