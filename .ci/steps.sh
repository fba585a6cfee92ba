# Steps for .ci/run and .ci/long: `step` runs one here, `beside` runs one in the background, `join` waits for that one.
# A table of all steps with their seconds is printed at the end, whatever the end is.
# Sourced by bash, from the project's folder.

started=$SECONDS
notes=$(mktemp -d)
# Background steps are process groups, so that one can be ended with all that it started.
declare -A lanes=()

# step NAME COMMAND...: runs a command in a shell of its own that ends at the first failure, and notes its seconds.
step() {
    local name=$1 begin=$SECONDS code=0
    shift
    printf '\n== %s (at %s s)\n' "$name" "$((begin - started))"
    set +e
    (trap - EXIT; set -euo pipefail; "$@")
    code=$?
    set -e
    printf '%s\t%s\t%s\t%s\n' "$((begin - started))" "$((SECONDS - begin))" "$code" "$name" >>"$notes/table"
    return "$code"
}

# beside NAME COMMAND...: runs a command in the background. Its output is kept until `join NAME`.
beside() {
    local name=$1
    shift
    set -m
    (set +m; trap - EXIT; set -euo pipefail; "$@") >"$notes/$name.log" 2>&1 </dev/null &
    lanes[$name]=$!
    set +m
}

# join NAME: waits for a background command and prints its output. Its failure is a failure here.
join() {
    local name=$1 code=0
    wait "${lanes[$name]}" || code=$?
    unset "lanes[$name]"
    printf '\n== output of: %s\n' "$name"
    cat "$notes/$name.log"
    return "$code"
}

# Ends what still runs, and prints the table.
finish() {
    local code=$? name
    set +e
    for name in "${!lanes[@]}"; do
        kill -- "-${lanes[$name]}" 2>/dev/null
        wait "${lanes[$name]}" 2>/dev/null
        printf '\n== output of: %s (ended early)\n' "$name"
        tail -n 50 "$notes/$name.log" 2>/dev/null
    done
    printf '\n| begin, s | length, s | step |\n| ---: | ---: | --- |\n'
    sort -n "$notes/table" | awk -F'\t' '{ printf "| %d | %d | %s%s |\n", $1, $2, $4, $3 ? " (FAILED)" : "" }'
    printf '| 0 | %d | all |\n' "$((SECONDS - started))"
    rm -rf "$notes"
    exit "$code"
}
trap finish EXIT
trap 'exit 130' INT TERM
