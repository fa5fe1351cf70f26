"""The inductive link between two coils: its efficiency and its input resistance."""

from typing import Literal

from medjax.errors import InputError
from medjax.numerics.shapes import Floats, Numbers
from medjax.physics._arrays import as_floats


def link_efficiency(
    mutual_inductance: Numbers,
    *,
    load: Numbers,
    primary_resistance: Numbers,
    secondary_resistance: Numbers,
    angular_frequency: Numbers,
    form: Literal["circuit", "paper"] = "circuit",
) -> Floats:
    """Share of the primary's input power that reaches the load, by the paper's eq (6).

    The form "circuit" is the circuit solution for two series-resonant coils,
    Z_L / {(R_EV + Z_L) [1 + R_MED (R_EV + Z_L) / (w0 M)^2]}. The form "paper" has R_MED for R_EV in the first factor,
    as printed; both agree for equal resistances. All arguments broadcast to the shape of the result, `(...)`.

    Args:
      mutual_inductance: M, H, of either sign.
      load: resistance of the load seen by the secondary (Z_L), ohm, positive.
      primary_resistance: resistance of the primary coil (R_MED), ohm, not negative.
      secondary_resistance: resistance of the secondary coil (R_EV), ohm, not negative.
      angular_frequency: angular resonance frequency (w0 = 2 pi f), rad/s.
      form: "circuit" or "paper".

    Returns:
      The efficiency in [0, 1], in the widest floating type among the arguments. It is 0 with gradient 0 where M = 0,
      but has no limit there if the primary is lossless.

    Raises:
      InputError: `form` is neither of the two.
    """
    if form not in ("circuit", "paper"):
        raise InputError(f"form is {form!r}, must be 'circuit' or 'paper'")
    m, load, primary, secondary, omega = as_floats(
        mutual_inductance, load, primary_resistance, secondary_resistance, angular_frequency
    )
    # w0 M is of the order of the resistances, but M^2 alone nears the smallest float32. The inverted fraction avoids a
    # division by zero at M = 0.
    coupling = (omega * m) ** 2
    reaches_secondary = coupling / (coupling + primary * (secondary + load))
    in_series = secondary if form == "circuit" else primary
    return load / (in_series + load) * reaches_secondary


def input_resistance(
    mutual_inductance: Numbers,
    *,
    load: Numbers,
    primary_resistance: Numbers,
    secondary_resistance: Numbers,
    angular_frequency: Numbers,
) -> Floats:
    """Input resistance of two series-resonant coils at resonance, R_MED + (w0 M)^2 / (R_EV + Z_L).

    A primary current I (RMS) draws I^2 times this from the source, so the coil's current limit bounds the power of a
    link. All arguments broadcast, `(...)`; they are those of `link_efficiency`.

    Returns:
      Resistance in ohm, in the widest floating type among the arguments.

    Source: Kirchhoff's laws for the circuit of the paper's eq (6); Sallan et al. 2009, IEEE TIE 56(6).
    """
    m, load, primary, secondary, omega = as_floats(
        mutual_inductance, load, primary_resistance, secondary_resistance, angular_frequency
    )
    return primary + (omega * m) ** 2 / (secondary + load)
