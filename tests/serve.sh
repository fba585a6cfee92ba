# Servers for the scripts that test one from outside. Sourced by sh after `server` has the path of the program.
# Gives $work, a temporary folder, which is removed at the end as the servers are.

work=$(mktemp -d)
servers=
trap 'for pid in $servers; do kill "$pid" 2>/dev/null || true; done; rm -rf "$work"' EXIT

# serve NAME OPTION...: starts a server on loopback ports. Its output is in $work/NAME.out and $work/NAME.log.
serve() {
    name=$1
    shift
    "$server" serve --listen 127.0.0.1:0 "$@" >"$work/$name.out" 2>"$work/$name.log" &
    servers="$servers $!"
    echo $! >"$work/$name.pid"
}

# address NAME WORDS: waits for a server's line that begins so ("tessera listens on"), and prints the address in it.
address() {
    tries=0
    until grep -q "^$2 " "$work/$1.out"; do
        tries=$((tries + 1))
        if [ "$tries" -gt 600 ] || ! kill -0 "$(cat "$work/$1.pid")" 2>/dev/null; then
            echo "the server did not start:" >&2
            cat "$work/$1.log" >&2
            exit 1
        fi
        sleep 0.1
    done
    sed -n "s/^$2 //p" "$work/$1.out"
}

# client COMMAND...: runs a command; if it fails, the logs of the servers are shown.
client() {
    "$@" || {
        tail -n 50 "$work"/*.log >&2
        exit 1
    }
}

# Ends all servers, each of which must end well.
stop() {
    for pid in $servers; do
        kill -TERM "$pid"
        code=0
        wait "$pid" || code=$?
        [ "$code" -eq 0 ] || { echo "a server ended with $code" >&2; exit 1; }
    done
    servers=
    echo "ok"
}
