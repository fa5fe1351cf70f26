"""How vehicles drive: car following and a lane change."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from docs.figures.look import BLUE, CURVES
from medjax.traffic import idm_acceleration
from medjax.traffic.motion import Steering, lateral_step
from medjax.world.kinds import HUMAN_EV
from medjax.world.params import EnvParams
from train.reporting.figures import new_figure, save

IDM = ("desired_speed", "time_headway", "min_gap", "max_acceleration", "comfortable_deceleration")


def draw_idm(path: Path, params: EnvParams) -> None:
    """IDM acceleration over gap and speed: behind a vehicle of the same speed, and behind a MED."""
    from matplotlib.colors import TwoSlopeNorm

    drivers, figure = params.drivers, new_figure(8.5, 3.9)
    gap, speed = np.meshgrid(np.linspace(2, 120, 237), np.linspace(0, 35, 141))
    service = float(params.fleet.service_speed)
    panels = {
        "the vehicle ahead is as fast": speed,
        f"the vehicle ahead drives {service:.0f} m/s, as a MED": np.full_like(speed, service),
    }
    levels = (-9, -6, -4, -2, -1, -0.5, 0, 0.5, 1, 1.4)
    for axes, (title, leader) in zip(
        figure.subplots(1, 2, sharex=True, sharey=True), panels.items(), strict=True
    ):
        numbers = {name: getattr(drivers, name)[HUMAN_EV] for name in IDM}
        acceleration = idm_acceleration(speed, gap, leader, **numbers)
        values = np.clip(acceleration, levels[0], levels[-1])
        norm = TwoSlopeNorm(0.0, levels[0], levels[-1])
        filled = axes.contourf(gap, speed, values, levels, cmap="PuOr", norm=norm)
        axes.contour(gap, speed, values, [0.0], colors="black", linewidths=2)
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("gap, bumper to bumper (m)")
    figure.axes[0].set_ylabel("speed (m/s)")
    bar = figure.colorbar(filled, ax=figure.axes[:2], ticks=levels)
    bar.set_label("acceleration (m/s²), at least −9; line: 0")
    save(figure, path)


def draw_lane_change(path: Path, params: EnvParams) -> None:
    """A lane change: distance to the new lane's centre and heading over time."""
    step, motion = 0.05, params.motion
    steering = Steering(motion.lateral_rate, motion.lateral_acceleration, motion.lateral_speed)
    offset, drift = jnp.asarray(params.road.lane_width_m), jnp.zeros(())
    track = []
    for _ in range(81):
        track.append((float(offset), float(drift)))
        offset, drift = lateral_step(offset, drift, jnp.zeros(()), steering, step)
    times, (offsets, drifts) = np.arange(len(track)) * step, np.transpose(track)
    figure = new_figure(8.5, 3.2)
    left, right = figure.subplots(1, 2, sharex=True)
    left.plot(times, offsets, color=BLUE, lw=2)
    left.axhline(0.05 * offsets[0], color="black", lw=1, ls=":")
    left.text(4.0, 0.05 * offsets[0] + 0.08, "5 % left to go", ha="right", va="bottom")
    left.set_ylabel("distance to the new lane's centre (m)")
    for (color, style), speed in zip(CURVES, (18.0, 25.0, 30.0), strict=False):
        angle = np.degrees(np.arctan2(-drifts, speed))
        right.plot(times, angle, color=color, ls=style, lw=2, label=f"{speed:.0f} m/s")
    right.set_ylabel("heading against the road (°)")
    right.legend(title="speed")
    for axes in (left, right):
        axes.set(xlabel="time since the change (s)", xlim=(0, 4), ylim=(0, None))
        axes.grid(alpha=0.3)
    save(figure, path)
