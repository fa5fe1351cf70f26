"""One instant of the road for drawing, from a recording or from a state."""

import dataclasses

import jax
import numpy as np

from medjax.episodes.recording import Frames, Recording, frame_of
from medjax.render.roadway import Roadway
from medjax.render.tracks import class_of, ran_out, tracks_of
from medjax.traffic.road import lateral_position
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import NOT_BOOKED, EnvState


@dataclasses.dataclass(frozen=True)
class Scene:
    """V vehicle slots: first M of MEDs, then E of EVs, then the others."""

    x: np.ndarray  # (V,) m, front bumper
    y: np.ndarray  # (V,) m right of the leftmost lane's centre
    heading: np.ndarray  # (V,) rad, positive to the right
    active: np.ndarray  # (V,) bool, on the road
    kind: np.ndarray  # (V,) int, `medjax.world.kinds.KINDS`
    ev_soc: np.ndarray  # (E,)
    ev_med: np.ndarray  # (E,) int, -1 for none
    ev_charging_slot: np.ndarray  # (E,) int, -1 for none
    ev_is_charging: np.ndarray  # (E,) bool
    med_soc: np.ndarray  # (M,)
    med_status: np.ndarray  # (M,) int
    gone_x: np.ndarray  # (D,) m, where EVs without energy left the road so far, where known
    ran_out: int  # EVs that ran out so far
    sent: int  # MEDs dispatched so far
    fleet: int  # size of the fleet
    time_s: float
    title: str
    names: tuple[str, ...]  # of the vehicle in each slot

    @property
    def num_meds(self) -> int:
        """M, which is also the slot of the first EV."""
        return len(self.med_soc)

    @property
    def evs_on_road(self) -> np.ndarray:
        """Which EVs are on the road, (E,) bool."""
        return self.active[self.num_meds : self.num_meds + len(self.ev_soc)]

    @property
    def ran_out_x(self) -> np.ndarray:
        """Where EVs that ran out are, or left the road, m."""
        xs = self.x[self.num_meds : self.num_meds + len(self.ev_soc)]
        return np.append(self.gone_x, xs[self.evs_on_road & (self.ev_soc <= 0.0)])

    @property
    def is_booked(self) -> np.ndarray:
        """Which EVs on the road have a slot, (E,) bool."""
        return self.evs_on_road & (self.ev_med != NOT_BOOKED)


def _scene_of(frame: Frames, params: EnvParams, **told: object) -> Scene:
    """The scene of a single frame without a time axis; `told` adds the fields that a frame lacks."""
    y = lateral_position(frame.lane, frame.lateral_offset, params.road.lane_width_m)
    shown = {field.name for field in dataclasses.fields(Scene)}
    known: dict[str, object] = {
        name: np.asarray(values) for name, values in vars(frame).items() if name in shown
    }
    # The floor keeps crawling vehicles straight, as in `medjax.traffic.motion.heading_difference`.
    heading = np.arctan2(np.asarray(frame.lateral_speed), np.maximum(frame.speed, 1.0))
    known |= {"x": np.asarray(frame.x, np.float64), "y": np.asarray(y), "heading": heading}
    return Scene(**known | told, fleet=int(params.fleet.size))  # type: ignore[arg-type]


def scene_of_state(state: EnvState, config: EnvConfig, params: EnvParams, title: str) -> Scene:
    """The scene of one environment's state, which knows where EVs ran out only if they are still on the road."""
    return _scene_of(
        frame_of(state, params),
        params,
        gone_x=np.zeros(0),
        ran_out=int(state.stats.depleted),
        sent=int(state.stats.meds_dispatched),
        time_s=int(state.time) * config.decision_s,
        title=title,
        names=tuple(class_of(slot, config) for slot in range(config.num_vehicles)),
    )


class Timeline:
    """A recording that can be viewed at any time, between ticks as well."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.roadway = Roadway.of(recording.config, recording.params)
        self.tracks = tracks_of(recording)
        self.ran_out = ran_out(recording)
        self._track_at = recording.vehicle_ids()  # (F, V) index into `tracks`; -1 is an empty slot

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return (len(self.recording.frames.x) - 1) * self.recording.config.tick_s

    def frame_at(self, time_s: float) -> int:
        """The last frame at or before a time, within the recording."""
        index = int(time_s / self.recording.config.tick_s + 1e-6)
        return min(max(index, 0), len(self.recording.frames.x) - 1)

    def at(self, time_s: float) -> Scene:
        """The scene at a time in s: that of the last tick, with positions moved on toward the next tick.

        Positions are interpolated linearly. A vehicle that is gone by the next tick goes on at its speed.
        """
        recording, frames = self.recording, self.recording.frames
        now = self.frame_at(time_s)
        share = time_s / recording.config.tick_s - now
        here = self._track_at[now]
        decision = -(-now // recording.ticks_per_decision)
        scene = _scene_of(
            jax.tree.map(lambda leaf: leaf[now], frames),
            recording.params,
            gone_x=np.array([stop.x_m for stop in self.ran_out if stop.gone <= now]),
            ran_out=sum(stop.frame <= now for stop in self.ran_out),
            sent=int(np.sum(np.asarray(recording.decisions.sent)[:decision] > 0)),
            time_s=time_s,
            title=f"{recording.scenario} · {recording.policy}",
            names=tuple(self.tracks[i].name if i >= 0 else "" for i in here),
        )
        if share < 1e-6 or now + 1 == len(frames.x):
            return scene
        stays = self._track_at[now + 1] == here
        width = self.roadway.lane_width_m
        next_y = frames.lane[now + 1] * width + frames.lateral_offset[now + 1]
        ahead = np.where(
            stays, frames.x[now + 1] - scene.x, frames.speed[now] * recording.config.tick_s
        )
        aside = np.where(stays, next_y - scene.y, 0.0)
        return dataclasses.replace(scene, x=scene.x + share * ahead, y=scene.y + share * aside)
