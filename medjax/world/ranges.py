"""The allowed range of every number, by the name that `medjax.make` takes; docs/parameters.md lists them.

They are wide: what they leave out is not meant, is no number in float32, or breaks what the simulator rests on. Below,
positions stay exact to 2 cm, and vehicles that follow each other are told apart by the sort of the road.
"""

from __future__ import annotations

import math

from medjax.world.limits import Limits

SHARE = Limits(0, 1)
WEIGHT = Limits(-1e9, 1e9)

SIZES: dict[str, Limits] = {
    "num_meds": Limits(1, 64, whole=True),
    "num_evs": Limits(1, 4096, whole=True),
    "num_gas": Limits(0, 4096, whole=True),
    "num_lanes": Limits(1, 6, whole=True),
    "num_ramps": Limits(0, 8, whole=True),
    "tick_s": Limits(0.02, 0.5),  # the ballistic update is stable up to half a second
    "ticks_per_decision": Limits(1, 100, whole=True),
}

ROAD = {
    "length_m": Limits(100, 200e3),
    "lane_width_m": Limits(2, 10),
    "ramp_x_m": Limits(0, 200e3, per="ramp"),
    "acceleration_lane_m": Limits(10, 5000),
}
DEMAND = {
    "mainline_per_h": Limits(0, 100e3),
    "ramp_per_h": Limits(0, 100e3, per="ramp"),
    "ev_share": SHARE,
    "human_share": SHARE,
    "arrival_soc_low": SHARE,
    "arrival_soc_high": SHARE,
    "ramp_speed": Limits(1, 60),
}
DRIVERS = {
    "desired_speed": Limits(1, 100, per="kind"),
    "desired_speed_std": Limits(0, 20, per="kind"),
    "time_headway": Limits(0.1, 10, per="kind"),
    "min_gap": Limits(0.1, 20, per="kind"),
    "max_acceleration": Limits(0.1, 20, per="kind"),
    "comfortable_deceleration": Limits(0.1, 20, per="kind"),
    "acceleration_noise": Limits(0, 5, per="kind"),
    "lateral_wander": Limits(0, 2, per="kind"),
    "vehicle_length": Limits(2, 50, per="kind"),
}
MOTION = {
    "max_braking": Limits(1, 50),
    "noise_time_s": Limits(0.1, 10e3),
    "lateral_rate": Limits(0.1, 20),
}
LANE_CHANGE = {
    "politeness": SHARE,
    "threshold": Limits(0, 100),
    "right_bias": Limits(-100, 100),
    "safe_braking": Limits(0.1, 50),
    "mandatory_bias": Limits(0, 1000),
    "urgency_bias": Limits(0, 1000),
}
FLEET = {
    "size": Limits(0, 64, whole=True),
    "cooldown_s": Limits(0, 1e6),
    "turnaround_s": Limits(0, math.inf),
    "service_speed": Limits(1, 100),
    "service_lane": Limits(0, 5, whole=True),
    "reserve_soc": SHARE,
}
CHARGING = {
    "request_soc": SHARE,
    "target_soc": SHARE,
    "reach_ahead_m": Limits(0, 200e3),
    "reach_behind_m": Limits(0, 200e3),
    "patience_s": Limits(0.1, 1e6),
    "retry_s": Limits(0, 1e6),
    "approach_speed": Limits(0.1, 50),
    "approach_rate": Limits(0.01, 10),
    "speed_rate": Limits(0.01, 20),
    "platoon_headway": Limits(0.01, 10),
    "platoon_min_gap": Limits(0.1, 20),
    "dock_gap_m": Limits(0.1, 100),
    "dock_tolerance_m": Limits(0.001, 10),
    "dock_speed_tolerance": Limits(0.001, 10),
    "hold_tolerance_m": Limits(0.001, 10),
    "slot_power_w": Limits(0, 10e6),
}
LINK = {
    "panel_gap_m": Limits(0.05, 1),  # the coils' table goes so far
    "misalignment_scale": Limits(0, 10),
    "load_ohm": Limits(1e-3, 1e6),
    "med_resistance_ohm": Limits(1e-6, 10e3),
    "ev_resistance_ohm": Limits(1e-6, 10e3),
    "angular_frequency": Limits(1, 1e9),
}
BODY = {
    "mass_kg": Limits(1, 1e6),
    "drag_coefficient": Limits(1e-3, 10),
    "frontal_area_m2": Limits(0.01, 100),
    "rolling_resistance": Limits(1e-4, 1),
    "rotational_inertia_factor": Limits(1, 10),
    "drivetrain_efficiency": Limits(0.01, 1),
    "regeneration_efficiency": SHARE,
    "auxiliary_w": Limits(0, 1e6),
    "pack_j": Limits(3.6e3, 3.6e12),  # 1 Wh to 1 GWh
}

GROUPS: dict[str, dict[str, Limits]] = {
    "road": ROAD,
    "demand": DEMAND,
    "drivers": DRIVERS,
    "motion": MOTION,
    "lane_change": LANE_CHANGE,
    "fleet": FLEET,
    "charging": CHARGING,
    "link": LINK,
    "ev": BODY,
    "med": BODY,
}
OTHERS = {
    "battery_scale": Limits(1e-3, 1e6),
    "episode_decisions": Limits(1, 10_000_000, whole=True),
}
COILS = {
    "med_coil_radius_m": Limits(0.01, 5),
    "ev_coil_radius_m": Limits(0.01, 5),
    "med_coil_turns": Limits(1, 1000),
    "ev_coil_turns": Limits(1, 1000),
}
