#!/bin/sh
# Sends an event of ridged as mail, with the last picture. In the settings:
#   [hooks]
#   paused = ["/usr/local/lib/ridged/mail.sh", "lab@example.org"]
# Needs jq and a sendmail program (postfix, msmtp-mta, …); SENDMAIL names another one.
set -eu
to=$1
event=$(cat)
field() { printf '%s' "$event" | jq -r "$1 // empty"; }
# A header line is ASCII and one line.
subject=$(field .message | tr -cd '\40-\176' | cut -c 1-150)
picture=$(field .last_frame.path)
boundary="ridged-$$-$(date +%s)"
{
    printf 'To: %s\nSubject: ridged: %s\nMIME-Version: 1.0\n' "$to" "$subject"
    printf 'Content-Type: multipart/mixed; boundary="%s"\n\n' "$boundary"
    printf -- '--%s\nContent-Type: text/plain; charset=utf-8\nContent-Transfer-Encoding: 8bit\n\n' "$boundary"
    field .message
    field .scan.url
    printf '\n%s\n' "$event" | jq .
    if [ -n "$picture" ] && [ -r "$picture" ]; then
        printf '\n--%s\nContent-Type: image/png\nContent-Transfer-Encoding: base64\n' "$boundary"
        printf 'Content-Disposition: attachment; filename="frame.png"\n\n'
        base64 "$picture"
    fi
    printf '\n--%s--\n' "$boundary"
} | "${SENDMAIL:-sendmail}" -t -i
