"""The environment that the settings name, on its own and as the batch that a learner steps."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

import medjax
from medjax.agents import agents_of
from medjax.commandline import read_object
from medjax.env.agents.view import AgentView
from medjax.env.contract import Environment
from medjax.env.observation import OBSERVATIONS
from medjax.env.reward import REWARDS
from medjax.env.wrapper import check_environment as check_is_environment
from medjax.episodes.runner import episode_decisions
from medjax.errors import InputError, shown, told
from medjax.numerics.devices import environment_mesh
from medjax.policies.about import about_of
from medjax.policies.rules import BASELINES
from medjax.policies.team import Dispatched
from medjax.scenarios import SCENARIOS, prepare
from medjax.wrappers import (
    BatchAutoReset,
    DecideEvery,
    EpisodeLog,
    RandomDemand,
    TimeLimitAsEnd,
)
from train.algorithms.networks import check_network
from train.algorithms.policy_prior import starts_from_rule
from train.option import SHARP_RULE, SOFT_RULE
from train.settings import TrainConfig


def make_environment(config: TrainConfig) -> tuple[Any, Any]:
    """The environment that the settings name, and its parameters.

    Raises:
        InputError: an unknown scenario, option or network, a value out of range, or devices that do not exist.
    """
    return _build(medjax.make, config)


def check_given(env: Any, config: TrainConfig) -> None:
    """Refuses (InputError) a user's own environment that the settings do not fit."""
    _check_devices(config)
    _check_fit(env, config)


def described(env: Any, params: Any, config: TrainConfig) -> tuple[TrainConfig, bool]:
    """The settings, updated to describe a given environment, and whether they can rebuild it.

    An environment that they cannot rebuild is named NAME-own.

    Args:
        env: a single environment.
        params: its parameters.
        config: settings; those of the environment are replaced.

    Raises:
        InputError: `env` is not an environment, or comes without parameters.
    """
    if params is None:
        raise InputError("env without params, allowed: both, as medjax.make gives them")
    check_is_environment(env)
    how: dict[str, Any] = {"reward": "preset", "wrapper": "none"}
    try:
        about = about_of(env, params, config.decide_every)
    except InputError:
        how |= {"scenario": f"{env.name}-own", "overrides": {}}
        if isinstance(env.observation, AgentView):
            how["agents"] = "ippo" if env.observation.road is None else "mappo"
            how["observation"] = "profile"
        return dataclasses.replace(config, **how), False
    how |= {"scenario": about.scenario, "overrides": dict(about.overrides)}
    if not about.agents:
        how |= {"agents": "none", "observation": about.observation}
        return dataclasses.replace(config, **how), True
    how["overrides"]["speeds"] = about.agents["speeds"]
    how["agents"] = "mappo" if about.agents["central"] else "ippo"
    how["observation"] = "profile"  # agents have their own, and the setting says nothing
    how["credit"] = about.agents["credit"]
    return dataclasses.replace(config, **how), True


def _check_devices(config: TrainConfig) -> None:
    if config.num_envs:  # otherwise it follows the length of an episode, which is not known yet
        environment_mesh(config.device_groups, config.num_devices, jax.devices())


def _check_fit(env: Any, config: TrainConfig) -> None:
    """Refuses (InputError) a network that cannot read the observation, and the sharpness of a rule that is no start."""
    check_network(config, env.observation)
    # A default may be that of another run, whose settings this one takes over.
    given = config.rule_sharpness not in (None, SOFT_RULE, SHARP_RULE)
    if given and not starts_from_rule(env, config):
        said = f"rule_sharpness is {config.rule_sharpness} without a start from the rule"
        raise InputError(f"{said}, allowed: {SOFT_RULE} or {SHARP_RULE}, its defaults")


def check_environment(config: TrainConfig) -> None:
    """Refuses (InputError) what `make_environment` refuses, without computing anything."""
    _build(prepare, config)


def _build(build: Callable[..., Any], config: TrainConfig) -> Any:
    # Building an environment compiles parts of it, so whatever can be refused without that is refused first.
    _check_devices(config)
    how: dict[str, Any] = dict(config.overrides)
    if config.reward != "preset":
        how["reward"] = _reward(config)
    if config.agents == "none":
        check_network(config, OBSERVATIONS.get(config.observation))
        wrap = None if config.wrapper == "none" else read_object("wrapper", config.wrapper)
        env, params, *_ = build(config.scenario, observation=config.observation, **how)
        if wrap is not None:
            env = _wrapped(env, wrap, config.wrapper)
            check_is_environment(env)
        _check_fit(env, config)
        return env, params
    how |= {"credit": config.credit, "central": config.agents == "mappo"}
    env, params = agents_of(config.scenario, build=build, **how)
    _check_fit(env, config)
    return env, params


def _wrapped(env: Any, wrap: Callable[[Any], Any], name: str) -> Any:
    """The environment in the user's wrapper; InputError if that fails."""
    try:
        return wrap(env)
    except Exception as error:  # user code may raise anything
        raise InputError(f"wrapper {shown(name)} failed to build: {told(error)}") from error


def _reward(config: TrainConfig) -> Any:
    """The reward that the settings name, in the form that `medjax.make` takes; InputError for two terms of a name."""
    if ":" not in config.reward:
        return config.reward
    own = [read_object("reward", text) for text in config.reward.split(",")]
    usual = SCENARIOS[config.scenario].reward if config.scenario in SCENARIOS else "paper"
    terms = dict(REWARDS[usual])
    for term in own:
        name = getattr(term, "__name__", "own")
        if name in terms:
            what = f"reward {shown(config.reward)}: there are two terms {shown(name)}"
            raise InputError(f"{what}, allowed: one of a name, the preset's among them")
        terms[name] = term
    return terms


def dispatched(env: Any, config: TrainConfig) -> Dispatched | None:
    """`env` of agents with the settings' rule as dispatcher; None without agents, or if they dispatch themselves."""
    if config.agents == "none" or config.dispatcher == "agents":
        return None
    return Dispatched(env, BASELINES[config.dispatcher](env.env))


def training_batch(
    env: Environment, params: Any, config: TrainConfig, bootstrap_timeouts: bool = False
) -> EpisodeLog:
    """The batch of `env` that a learner steps: one step per choice, with episode statistics and auto-reset.

    Args:
        env: a single environment.
        params: its parameters; only the length of an episode is read.
        config: settings.
        bootstrap_timeouts: the time limit truncates an episode; otherwise it terminates it.
    """
    env = dispatched(env, config) or env
    if config.demand_range != (1.0, 1.0):
        env = RandomDemand(env, *config.demand_range)
    if not bootstrap_timeouts:
        env = TimeLimitAsEnd(env)
    episode_choices = -(-episode_decisions(params) // config.decide_every)
    stagger = episode_choices if config.stagger else 0
    choices = DecideEvery(env, config.decide_every)
    return EpisodeLog(BatchAutoReset(choices, stagger=stagger, group=config.group_size))
