#!/usr/bin/env bash
# eclipse-sumo 1.28.0: energy from a pad in the road is that of whole time steps, or none
#
# One would expect: a car that drives over a charging pad (chargeInTransit="1") gets power times the time that it is
# on the pad. SUMO's induction loops time cars to a fraction of a step.
# What happens: a car is charged for a whole step where the step ends on the pad, and else not at all. A pad of 10 m at
# 30 m/s is passed in a third of a second. At the default step of 1 s two of three cars get nothing and the third gets
# three times its due. The mean over cars is about right, so totals look well; a car's own charge is a lottery, and cars
# that are at equal places when a step ends all win or all lose. Steps much shorter than the pass are needed.
# Source: src/microsim/devices/MSDevice_Battery.cpp, `notifyMove`; documentation:
# https://sumo.dlr.de/docs/Models/Electric.html#charging_stations
#
# Output seen:
# at the speed that a loop measures, a car is on the pad for 0.33 s: 9.26 Wh
# steps of 1 s: 0.00 to 27.78 Wh a car, 10.06 on average
# steps of 0.1 s: 8.33 to 11.11 Wh a car, 9.53 on average
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q eclipse-sumo==1.28.0
cat > road.nod.xml <<'XML'
<nodes><node id="a" x="0" y="0"/><node id="b" x="2000" y="0"/></nodes>
XML
cat > road.edg.xml <<'XML'
<edges><edge id="e" from="a" to="b" numLanes="1" speed="30"/></edges>
XML
cat > pad.add.xml <<'XML'
<additional>
  <chargingStation id="pad" lane="e_0" startPos="1000" endPos="1010" power="100000" efficiency="1"
                   chargeInTransit="1" chargeDelay="0"/>
  <instantInductionLoop id="loop" lane="e_0" pos="1000" file="loop.xml"/>
</additional>
XML
cat > show.py <<'PYTHON'
import subprocess
from xml.etree import ElementTree

CARS, DUE_WH = 58, 100_000 * 10.0 / 30.0 / 3600.0
with open("cars.rou.xml", "w") as file:
    file.write('<routes><vType id="ev" emissionClass="Energy/unknown" sigma="0" speedDev="0" maxSpeed="30">')
    file.write('<param key="has.battery.device" value="true"/>')
    file.write('<param key="device.battery.chargeLevel" value="10000"/></vType><route id="r" edges="e"/>')
    for number in range(CARS):
        # From places half a metre apart, so that steps end at all places of the pad.
        place = 100 + 0.53 * number
        file.write(f'<vehicle id="{number}" type="ev" route="r" depart="{5 * number}" ')
        file.write(f'departSpeed="30" departPos="{place:.2f}"/>')
    file.write("</routes>")


def charged(step):
    """Wh of each car."""
    files = ["-n", "road.net.xml", "-r", "cars.rou.xml", "-a", "pad.add.xml"]
    output = ["--chargingstations-output", "charged.xml", "--no-step-log", "true"]
    subprocess.run(["venv/bin/sumo", *files, *output, "--step-length", step], check=True, stdout=subprocess.DEVNULL)
    got = ElementTree.parse("charged.xml").iter("vehicle")
    found = {car.get("id"): float(car.get("totalEnergyChargedIntoVehicle")) for car in got}
    return [found.get(str(number), 0.0) for number in range(CARS)]


coarse = charged("1")
events = ElementTree.parse("loop.xml").iter("instantOut")
speeds = [float(event.get("speed")) for event in events if event.get("state") == "enter"]
assert len(speeds) == CARS and min(speeds) == max(speeds) == 30.0, speeds
print(f"at the speed that a loop measures, a car is on the pad for {10.0 / 30.0:.2f} s: {DUE_WH:.2f} Wh")
fine = charged("0.1")
for step, wh in (("1", coarse), ("0.1", fine)):
    print(f"steps of {step} s: {min(wh):.2f} to {max(wh):.2f} Wh a car, {sum(wh) / CARS:.2f} on average")
assert min(coarse) == 0.0 and max(coarse) > 2.9 * DUE_WH and coarse.count(0.0) > CARS / 2
assert max(fine) < 1.5 * DUE_WH and min(fine) > 0.5 * DUE_WH
PYTHON
venv/bin/netconvert -n road.nod.xml -e road.edg.xml -o road.net.xml > log.txt
venv/bin/python show.py
