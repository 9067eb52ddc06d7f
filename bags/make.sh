#!/bin/sh
# Remakes the sample bags, each as README.md says; run it in the project's environment.
set -eu
cd "$(dirname "$0")"
part=$(mktemp -d)
trap 'rm -r "$part"' EXIT

# pack SOURCE NAME: compress a bag.
pack() {
    rm -rf "$2"
    rosbags-convert --src "$1" --dst "$2" --dst-storage mcap \
        --compress zstd --compress-mode storage
}

# make NAME ARGUMENTS...: simulate three series, then pack them.
make() {
    name=$1
    shift
    hydro-twin simulate --plant load_simulator --snr 40 --quantisation 0.015625 "$@" \
        -o "$part/$name.mcap"
    pack "$part/$name.mcap" "$name"
}

multisine='--excitation u_m=multisine --excitation u_m=multisine --excitation u_m=chirp'

make load_simulator_linear --seed 1 --duration 3
make load_simulator_nonlinear --seed 7 --duration 3 \
    --set B_m=95 --set J=0.02 --set K_p=0.025 \
    --effect backlash@coupling:gap=1e-3 --effect friction@motor:coulomb=40 \
    --effect dead_zone@spool:width=5e-6 --effect orifice@flow:supply_pressure=6e6 \
    --excitation theta_d=random:bandwidth=60,amplitude=0.01 \
    --burst theta_d:begin=2,length=0.3,frequency=110,amplitude=0.007
make rig_a --duration 2.4 --seed 2 --effect friction@motor:coulomb=10
make rig_b --duration 2.4 --seed 3 --effect dead_zone@spool:width=3e-6
make rig_c --duration 2.4 --seed 4 --set J=0.05 --effect orifice@flow:supply_pressure=9e6
# shellcheck disable=SC2086
make rig_d --duration 2.4 --seed 5 $multisine --effect friction@motor:coulomb=8 \
    --effect rate_limit@spool:limit=5e-4
# shellcheck disable=SC2086
make rig_e --duration 2.4 --seed 6 $multisine --set K_ce=5e-12 --set B_m=60

python -m hydro_twin.studies.l18.demonstration "$part"
for name in valve_steps valve_limit valve_event; do
    pack "$part/$name" "$name"
done
