"""The preset `freight`: a motorway on which electric lorries charge; docs/parameters.md has the reasons."""

import numpy as np

# Mean of each hour of 2024 over the year's mean, 77.29 EUR/MWh, on the Dutch day-ahead market (ENTSO-E, as shipped
# with ev2gym 2.0.0, MIT licence): `python -m benchmarks.prices`.
DUTCH_2024 = (
    *(0.984, 0.911, 0.871, 0.835, 0.831, 0.885, 1.052, 1.226),
    *(1.245, 1.071, 0.885, 0.738, 0.628, 0.565, 0.582, 0.702),
    *(0.894, 1.194, 1.404, 1.529, 1.488, 1.287, 1.162, 1.032),
)
INTERCHANGES_M = 1_500.0 + 6_000.0 * np.arange(4)
J_PER_KWH = 3.6e6
PLUG_KW = 400.0
PLUG_EUR_PER_H = 50.0  # a lorry and its driver
EUR_PER_KWH = 0.40  # of energy that a lorry does not get from MEDs

SIZES = {
    "num_meds": 24,
    "num_evs": 144,
    "num_gas": 288,
    "num_lanes": 3,
    "num_ramps": 4,
    "num_exits": 4,
    "num_depots": 4,
    "num_plugs": 4,
    "num_surges": 2,
    "has_detectors": 1,
    "rounds_per_decision": 10,
}
NUMBERS = {  # that differ from those of `corridor`
    "exit_x_m": INTERCHANGES_M - 300.0,
    "ramp_x_m": INTERCHANGES_M + 300.0,
    "exit_share": np.full(4, 0.05),
    "mainline_per_h": 900.0,
    "ramp_per_h": np.array([40.0, 80.0, 40.0, 60.0]),
    "profile": np.ones((1, 5)),
    "start_s": 13.0 * 3600.0,
    "surge_factor": 4.0,
    "surge_until_s": 2700.0,
    "hourly_price": DUTCH_2024,
    "ev_share": 0.3,
    "lorry_share": 0.25,
    "eco_compliance": 0.0,
    "arrival_soc_low": 0.1,
    "arrival_soc_high": 0.7,
    "desired_speed": [23.0, 23.6, 23.6, 32.0, 23.6],
    "desired_speed_std": [0.0, 0.7, 0.7, 3.0, 0.7],
    "time_headway": [1.5, 2.0, 1.5, 1.4, 2.0],
    "min_gap": [3.0, 4.0, 4.0, 2.0, 4.0],
    "max_acceleration": [0.5, 0.5, 0.5, 1.4, 0.5],
    "acceleration_noise": [0.02, 0.05, 0.01, 0.1, 0.05],
    "lateral_wander": [0.02, 0.1, 0.02, 0.15, 0.1],
    "vehicle_length": [16.5, 16.5, 16.5, 4.7, 16.5],
    "vehicle_width": [2.55, 2.55, 2.55, 1.8, 2.55],
    "ev.pack_j": 600.0 * J_PER_KWH,
    "ev.mass_kg": 40_000.0,
    "ev.drag_coefficient": 0.5,
    "ev.frontal_area_m2": 10.0,
    "ev.rolling_resistance": 0.0055,
    "ev.auxiliary_w": 3_000.0,
    "service_speed": 21.0,
    "trip_m": 21_000.0,
    "slot_power_w": 190e3,
    "max_current_a": 100.0,
    "plug_power_w": PLUG_KW * 1e3,
    "queue_seen_share": 0.5,
    "request_soc": 0.5,
    "wanted_soc": 0.5,
    "target_soc": 0.8,
    "reach_ahead_m": 400.0,
    "reach_behind_m": 400.0,
    "approach_speed": 3.5,
    "patience_s": 400.0,
}
PRICES = {
    "delay_h": -45.0,
    # Whoever uses a kWh charges it again, here or beyond the road. So the time at a plug is paid with the kWh, and the
    # time of stops on this road is given back. Otherwise a stop put off beyond the road would be a gain.
    "ev_kwh": -(EUR_PER_KWH + PLUG_EUR_PER_H / PLUG_KW),
    "plug_kwh": PLUG_EUR_PER_H / PLUG_KW,
    "charging_stops": 0.0,
    "plug_h": -PLUG_EUR_PER_H,
    "med_wear_kwh": -0.04,
}
BUDGET = {
    "pack": 3.83,
    "coming": 0.42,
    "free": -0.94,
    "ahead": 11.13,
    "time_left": -3.49,
    "ramp": (-4.96, -4.43, -2.91, -6.21),
}
