#!/usr/bin/env bash
# SUMO 1.28.0: carFollowModel="IDM" brakes harder than its `decel`, with a kilometre to stop in.
#
# Expected: `decel` is "the deceleration ability" of a vehicle and `emergencyDecel` what it takes when in danger, so
#   that a driver who sees a standing vehicle 1 km ahead stays within decel, as SUMO's Krauss drivers do.
# What happens: IDM takes `decel` for its comfortable deceleration b, which enters the wanted gap and bounds nothing: the
#   car comes to 2.16 m/s2 at decel="2.0", far from any emergency. A bound on braking read off an IDM vehicle type is
#   no bound. (Documentation: sumo.dlr.de, "Definition of Vehicles, Vehicle Types, and Routes", `decel`.)
# Source: src/microsim/cfmodels/MSCFModel_IDM.cpp.
# Output seen:
#   SUMO 1.28.0, ballistic update, ticks of 0.25 s, decel 2.0 m/s2: hardest braking of IDM 2.16, of Krauss 2.00 m/s2
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "eclipse-sumo==1.28.0"
cat > "$folder/brake.py" <<'PYTHON'
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import sumo

folder, binaries = Path(sys.argv[1]), Path(sumo.SUMO_HOME) / "bin"


def hardest_braking(model):
    """Of a car that comes up to a standing one, 1 km away at 30 m/s, m/s2."""
    (folder / "a.nod.xml").write_text('<nodes><node id="a" x="0" y="0"/><node id="b" x="3000" y="0"/></nodes>')
    (folder / "a.edg.xml").write_text('<edges><edge id="e" from="a" to="b" numLanes="1" speed="40"/></edges>')
    (folder / "a.rou.xml").write_text(
        f'<routes><vType id="t" carFollowModel="{model}" accel="1.4" decel="2.0" emergencyDecel="9" tau="1.4"'
        ' minGap="2" length="5" maxSpeed="30" speedFactor="1" speedDev="0" sigma="0"/><route id="r" edges="e"/>'
        '<vehicle id="still" type="t" route="r" depart="0" departPos="1205" departSpeed="0">'
        '<stop lane="e_0" startPos="1195" endPos="1205" duration="1000"/></vehicle>'
        '<vehicle id="comes" type="t" route="r" depart="0" departPos="200" departSpeed="30"/></routes>'
    )
    seen = folder / "seen.xml"
    net = ["-n", "a.nod.xml", "-e", "a.edg.xml", "-o", "a.net.xml"]
    play = ["-n", "a.net.xml", "-r", "a.rou.xml", "--step-length", "0.25", "--step-method.ballistic", "true"]
    play += ["--end", "120", "--fcd-output", seen, "--fcd-output.acceleration", "true", "--no-step-log", "true"]
    for program, words in (("netconvert", net), ("sumo", play)):
        subprocess.run([binaries / program, *words], cwd=folder, check=True, capture_output=True)
    rows = [row for step in ElementTree.parse(seen).getroot() for row in step if row.get("id") == "comes"]
    assert float(rows[-1].get("speed")) == 0.0
    return -min(float(row.get("acceleration")) for row in rows)


idm, krauss = hardest_braking("IDM"), hardest_braking("Krauss")
print(
    f"SUMO {version('eclipse-sumo')}, ballistic update, ticks of 0.25 s, decel 2.0 m/s2: "
    f"hardest braking of IDM {idm:.2f}, of Krauss {krauss:.2f} m/s2"
)
sys.exit(not (idm > 2.1 and krauss < 2.01))
PYTHON
"$folder/venv/bin/python" "$folder/brake.py" "$folder"
