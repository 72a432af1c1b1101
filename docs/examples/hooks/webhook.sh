#!/bin/sh
# Posts an event of ridged to a chat webhook. In the settings:
#   [hooks]
#   completed = ["/usr/local/lib/ridged/webhook.sh", "/etc/ridged/webhook"]
# The file holds the address of the webhook alone (mode 0600, readable by the daemon's user): each program that knows the address
# can post. Services that take `payload_json` with a file (Discord) get the last picture; with `text` as second argument
# the script sends {"text": …} alone, as Slack, Mattermost and Rocket.Chat expect. Needs jq and curl.
set -eu
address=$(cat "$1")
style=${2:-picture}
event=$(cat)
field() { printf '%s' "$event" | jq -r "$1 // empty"; }
text=$(field .message)
picture=$(field .last_frame.path)
# The address goes to curl on stdin, so that the list of processes does not show it.
send() { printf 'url = "%s"\n' "$address" | curl --config - --silent --show-error --fail --max-time 25 --output /dev/null "$@"; }
if [ "$style" = text ]; then
    send --header 'content-type: application/json' --data "$(jq -n --arg text "$text" '{text: $text}')"
elif [ -n "$picture" ] && [ -r "$picture" ]; then
    send --form-string "payload_json=$(jq -n --arg text "$text" '{content: $text}')" --form "file=@$picture;type=image/png"
else
    send --form-string "payload_json=$(jq -n --arg text "$text" '{content: $text}')"
fi
