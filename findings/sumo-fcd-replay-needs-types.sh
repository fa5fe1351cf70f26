#!/bin/bash
# SUMO cannot replay the floating-car data that it wrote, unless it is told again of the vehicle types in it.
#
# Tool: SUMO 1.28.0 (PyPI: eclipse-sumo), options --fcd-output and --device.fcd-replay.files.
# Expected: a file of --fcd-output names the type of each vehicle, and the replay only puts vehicles where the file has
#   them. A name that nobody defined could stand for the default type, as `type` may be left out of the schema.
# What happens: the replay ends with "Unknown vType" at the first vehicle, whatever there is in the file about it. With an
#   additional file that has an empty <vType id="..."/> for each name it replays every row at its place.
# Source: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html (the file); `sumo --help`, "FCD Replay Device Options".
# Output seen:
#   without types: exit 1, Error: Unknown vType 'car'.
#   with types: exit 0, 20 rows written, 20 replayed
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

python3 -m venv env
env/bin/pip install -q --disable-pip-version-check "eclipse-sumo==1.28.0"
SUMO_HOME=$(env/bin/python -c 'import sumo; print(sumo.SUMO_HOME)')
export SUMO_HOME

echo '<nodes><node id="a" x="0" y="0"/><node id="b" x="1000" y="0"/></nodes>' > road.nod.xml
echo '<edges><edge id="road" from="a" to="b" numLanes="2"/></edges>' > road.edg.xml
"$SUMO_HOME/bin/netconvert" -n road.nod.xml -e road.edg.xml -o road.net.xml > /dev/null
cat > car.rou.xml <<'XML'
<routes>
    <vType id="car"/>
    <vehicle id="one" type="car" depart="0"><route edges="road"/></vehicle>
</routes>
XML
"$SUMO_HOME/bin/sumo" -n road.net.xml -r car.rou.xml --end 20 --no-step-log --fcd-output written.xml > /dev/null

echo '<additional><vType id="car"/></additional>' > types.add.xml
replay=("$SUMO_HOME/bin/sumo" -n road.net.xml --device.fcd-replay.files written.xml --end 20 --no-step-log --no-warnings)

status=0
"${replay[@]}" > refused.txt 2>&1 || status=$?
echo "without types: exit $status, $(grep Error refused.txt)"
[ "$status" -ne 0 ]
grep -q "Unknown vType 'car'" refused.txt

"${replay[@]}" -a types.add.xml --fcd-output replayed.xml > /dev/null 2>&1
written=$(grep -c '<vehicle' written.xml)
replayed=$(grep -c '<vehicle' replayed.xml)
echo "with types: exit 0, $written rows written, $replayed replayed"
[ "$written" -eq "$replayed" ]
