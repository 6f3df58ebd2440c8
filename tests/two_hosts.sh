#!/usr/bin/env bash
# An MPI command on two hosts that share nothing but files, on one machine: what ranks on one host
# may send each other through shared memory, or for free, has to cross a link here, and is counted.
#
#   tests/two_hosts.sh [--rate 1gbit] [--count FILE] [--env NAME=VALUE]... RANKS COMMAND [ARGS...]
#
# Each host is a network namespace with a host name, System V memory and a /dev/shm of its own; a
# pair of virtual devices joins the two. Open MPI starts its daemon on the second one through a
# stand-in for ssh. Ranks go to the hosts in turns (even ones to the first), and have the folder and
# the environment that the script has; no rank is bound to a core. Ranks of one host use TCP as well,
# over its loopback device, which is not counted.
#
#   --rate RATE       what the link carries in each direction, as tc writes it; no limit by default
#   --count FILE      where the bytes go that crossed the link both ways: messages, their headers (one
#                     for each large segment of up to 64 KB), and some 6 KB of Open MPI's own
#   --env NAME=VALUE  a variable for the ranks alone
#
# The exit code is mpirun's. 2: a wrong argument; 77: skipped, with the reason; 129, 130, 143: ended by
# SIGHUP, SIGINT, SIGTERM, which mpirun gets as SIGTERM. Whatever ends the script, SIGKILL included,
# nothing that it made is left.
set -euo pipefail

misuse() {
    echo "two_hosts.sh: $1" >&2
    echo "usage: two_hosts.sh [--rate 1gbit] [--count FILE] [--env NAME=VALUE]... RANKS COMMAND..." >&2
    exit 2
}

skip() {
    echo "two_hosts.sh: skipped: ${1%%$'\n'*}" >&2
    exit 77
}

# Becomes a command on a host.
on() {
    # shellcheck disable=SC2016 # for the inner shell
    exec ip netns exec "$1" unshare --uts --ipc --mount sh -c '
        hostname "$0" && mount -t tmpfs tmpfs /dev/shm && exec "$@"' "$@"
}

# Makes both hosts and the link.
set_up() {
    local host last=1
    for host in "${hosts[@]}"; do
        ip netns add "$host" || return
    done
    ip link add eth0 netns "${hosts[0]}" type veth peer name eth0 netns "${hosts[1]}" || return
    for host in "${hosts[@]}"; do
        # No addresses of IPv6: their upkeep would be counted.
        ip -n "$host" link set eth0 addrgenmode none &&
            ip -n "$host" address add "10.0.0.$last/24" dev eth0 &&
            ip -n "$host" link set lo up &&
            ip -n "$host" link set eth0 up || return
        if [[ -n $rate ]]; then
            tc -n "$host" qdisc add dev eth0 root tbf rate "$rate" burst 256kb latency 50ms || return
        fi
        (on "$host" true) || return
        last=$((last + 1))
    done
}

# Ends all that runs on hosts, and removes them and the folder.
# shellcheck disable=SC2329 # another shell calls it
sweep() {
    local folder=$1 host pids
    shift
    for host; do
        for _ in {1..100}; do
            pids=$(ip netns pids "$host" 2>/dev/null) && [[ -n $pids ]] || break
            # shellcheck disable=SC2086 # several numbers
            kill -KILL $pids 2>/dev/null
            sleep 0.05
        done
        ip netns delete "$host" 2>/dev/null
    done
    rm -rf "$folder"
}

# Bytes that both ends of the link have sent.
traffic() {
    local host sum=0
    for host in "${hosts[@]}"; do
        sum=$((sum + $(ip netns exec "$host" cat /sys/class/net/eth0/statistics/tx_bytes)))
    done
    echo "$sum"
}

# Lets mpirun end the ranks, and leaves those that will not go to the sweep.
# shellcheck disable=SC2329 # traps call it
stop() {
    trap '' HUP INT TERM
    if [[ -n $run ]] && kill -TERM "$run" 2>/dev/null; then
        for _ in {1..100}; do
            kill -0 "$run" 2>/dev/null || break
            sleep 0.1
        done
    fi
    exit "$1"
}

rate='' count='' run='' variables=()
while [[ ${1:-} == --* ]]; do
    [[ $# -ge 2 ]] || misuse "$1 needs a value"
    case $1 in
        --rate) rate=$2 ;;
        --count) count=$2 ;;
        --env) variables+=("$2") ;;
        *) misuse "there is no option $1" ;;
    esac
    shift 2
done
[[ $# -ge 2 ]] || misuse "a number of ranks and a command are needed"
ranks=$1
shift
[[ $ranks =~ ^[1-9][0-9]{0,3}$ ]] || misuse "\`$ranks\` is no number of ranks"
[[ -z $rate || ${rate,,} =~ ^[0-9]+(\.[0-9]+)?[kmgt]?(bit|bps)$ ]] || misuse "\`$rate\` is no rate such as 1gbit"
for variable in "${variables[@]}"; do
    [[ $variable =~ ^[A-Za-z_][A-Za-z0-9_]*= ]] || misuse "\`$variable\` is not NAME=VALUE"
done
if [[ -n $count ]]; then
    { : >"$count"; } 2>/dev/null || misuse "$count cannot be written"
fi

[[ $EUID -eq 0 ]] || skip "only root can make network namespaces"
for program in ip tc unshare setsid mount hostname mpirun orted; do
    command -v "$program" >/dev/null || skip "there is no $program"
done
[[ $(mpirun --version 2>&1) == *"Open MPI"* ]] || skip "mpirun is not Open MPI's"

hosts=("two-hosts-$$-a" "two-hosts-$$-b")
folder=$(mktemp -d)
# Who sweeps waits for the end of a pipe that this shell holds open: that comes however it ends.
exec 9> >(setsid --wait bash -c "$(declare -f sweep); cat >/dev/null; sweep \"\$@\"" \
    sweep "$folder" "${hosts[@]}")
sweeper=$!
trap 'exec 9>&-; wait "$sweeper" || true' EXIT
trap 'stop 129' HUP
trap 'stop 130' INT
trap 'stop 143' TERM

said=$(set_up 2>&1) || skip "two hosts cannot be made: $said"
printf "%s slots=$ranks\n" "${hosts[@]}" >"$folder/hostfile"
# As ssh does, the agent joins its words and gives them to a shell.
cat >"$folder/agent" <<END
#!/usr/bin/env bash
$(declare -f on)
on "\$1" sh -c "\${*:2}"
END
chmod +x "$folder/agent"

# In the background, since a shell hears signals only while it waits.
on "${hosts[0]}" mpirun --allow-run-as-root -n "$ranks" --hostfile "$folder/hostfile" \
    --map-by node --bind-to none --mca plm_rsh_agent "$folder/agent" \
    --mca orte_tmpdir_base "$folder" --mca pml ob1 --mca btl tcp,self \
    --mca btl_tcp_if_include 10.0.0.0/24 --mca oob_tcp_if_include 10.0.0.0/24 \
    --mca mpi_yield_when_idle 1 env "${variables[@]}" "$@" 9>&- &
run=$!
code=0
wait "$run" || code=$?
run=
if [[ -n $count ]]; then
    traffic >"$count"
fi
exit "$code"
