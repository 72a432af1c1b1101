#!/bin/sh
# Lets a robot or PLC do an operator step, then confirms it. In the settings:
#   [hooks]
#   waiting = ["/usr/local/lib/ridged/robot.sh", "/usr/local/bin/load-part"]
#   time_limit_s = 300.0
# The program gets the action (cap-lens, place-white-reference, place-sample) and the name of the part, and must end
# successfully only if the step is done. RIDGED_TOKEN_FILE names a file with a token, where the daemon asks for one.
set -eu
program=$1
event=$(cat)
field() { printf '%s' "$event" | jq -r "$1 // empty"; }
"$program" "$(field .operator.action)" "$(field .operator.part)"
body=$(printf '%s' "$event" | jq -c .operator.continue_body)
{
    printf 'url = "%s"\n' "$(field .operator.continue_url)"
    if [ -n "${RIDGED_TOKEN_FILE:-}" ]; then
        printf 'header = "authorization: Bearer %s"\n' "$(cat "$RIDGED_TOKEN_FILE")"
    fi
} | curl --config - --silent --show-error --fail --header 'content-type: application/json' --data "$body" --output /dev/null
