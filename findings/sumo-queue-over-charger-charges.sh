#!/usr/bin/env bash
# eclipse-sumo 1.28.0: an electric vehicle that merely queues over a charging station is charged
#
# One would expect: with chargeInTransit="0" a charging station serves vehicles that stop for it, by
# `<stop chargingStation="...">`; whoever drives past, or waits in a jam on its lane, gets nothing.
# What happens: the battery device asks only whether the vehicle is on the station and slower than its stopping
# threshold. A vehicle without any stop, held up behind another one, takes the station's full power, and so does one
# whose stop names the lane alone. A study of charging on a congested road counts this energy unless stations lie on
# lanes of their own.
# Source: src/microsim/devices/MSDevice_Battery.cpp, `notifyMove`; documentation:
# https://sumo.dlr.de/docs/Models/Electric.html
#
# Output seen:
# lead, which stops on the lane for 120 s: 1667 Wh
# queued behind it, without a stop: 1562 Wh
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
cat > station.add.xml <<'XML'
<additional>
  <chargingStation id="station" lane="e_0" startPos="400" endPos="600" power="50000" efficiency="1"
                   chargeInTransit="0" chargeDelay="0"/>
</additional>
XML
cat > cars.rou.xml <<'XML'
<routes>
  <vType id="ev" emissionClass="Energy/unknown" sigma="0">
    <param key="has.battery.device" value="true"/>
    <param key="device.battery.capacity" value="30000"/>
    <param key="device.battery.chargeLevel" value="10000"/>
  </vType>
  <route id="r" edges="e"/>
  <vehicle id="lead" type="ev" route="r" depart="0"><stop lane="e_0" endPos="560" duration="120"/></vehicle>
  <vehicle id="queued" type="ev" route="r" depart="4"/>
</routes>
XML
venv/bin/netconvert -n road.nod.xml -e road.edg.xml -o road.net.xml > log.txt
venv/bin/sumo -n road.net.xml -r cars.rou.xml -a station.add.xml --step-length 0.5 \
  --chargingstations-output charged.xml --no-step-log true > log.txt
cat > show.py <<'PYTHON'
from xml.etree import ElementTree

cars = ElementTree.parse("charged.xml").iter("vehicle")
wh = {car.get("id"): float(car.get("totalEnergyChargedIntoVehicle")) for car in cars}
print(f"lead, which stops on the lane for 120 s: {wh['lead']:.0f} Wh")
print(f"queued behind it, without a stop: {wh['queued']:.0f} Wh")
assert wh["lead"] > 1500.0 and wh["queued"] > 1400.0, wh
PYTHON
venv/bin/python show.py
