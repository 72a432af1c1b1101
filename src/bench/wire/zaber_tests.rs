//! Golden bytes, recorded between the vendor's client zaber-motion 10.2.0 and a device, and
//! property tests.

use super::*;
use crate::bench::wire::zaber_stream::{Assembled, CommandAssembler, LineSplitter};
use proptest::prelude::*;

fn command(address: u8, axis: u8, id: Option<u8>, words: &str) -> DeviceCommand {
    DeviceCommand {
        address,
        axis,
        id,
        words: words.to_owned(),
    }
}

/// Commands of the vendor's client, byte for byte.
const COMMANDS: &[(u8, u8, Option<u8>, &str, &str)] = &[
    (0, 0, Some(0), "", "/0 0 00:00\n"),
    (
        1,
        0,
        Some(1),
        "get comm.packet.size.max",
        "/1 0 01 get comm.packet.size.max:CF\n",
    ),
    (1, 0, Some(0), "get deviceid", "/1 0 00 get deviceid:42\n"),
    (
        1,
        0,
        Some(1),
        "get system.serial",
        "/1 0 01 get system.serial:2B\n",
    ),
    (1, 0, Some(2), "get version", "/1 0 02 get version:77\n"),
    (
        1,
        0,
        Some(3),
        "get version.build",
        "/1 0 03 get version.build:38\n",
    ),
    (1, 0, Some(8), "get device.id", "/1 0 08 get device.id:0C\n"),
    (1, 1, Some(9), "get pos", "/1 1 09 get pos:23\n"),
    (1, 1, Some(10), "warnings", "/1 1 10 warnings:74\n"),
    (1, 1, Some(11), "home", "/1 1 11 home:33\n"),
    (
        1,
        1,
        Some(12),
        "warnings clear",
        "/1 1 12 warnings clear:4B\n",
    ),
    (1, 1, Some(13), "", "/1 1 13:FA\n"),
    (
        1,
        1,
        Some(40),
        "move abs 200000",
        "/1 1 40 move abs 200000:8B\n",
    ),
    (1, 1, Some(41), "", "/1 1 41:F9\n"),
    (0, 0, None, "set comm.alert 1", "/0 0 set comm.alert 1:B1\n"),
];

/// A device's reply, byte for byte.
type Recorded = (
    u8,
    u8,
    Option<u8>,
    bool,
    bool,
    &'static str,
    &'static str,
    &'static str,
);
const REPLIES: &[Recorded] = &[
    (
        1,
        0,
        Some(0),
        true,
        false,
        "WR",
        "0",
        "@01 0 00 OK IDLE WR 0:BE\r\n",
    ),
    (
        2,
        0,
        Some(0),
        true,
        false,
        "WR",
        "0",
        "@02 0 00 OK IDLE WR 0:BD\r\n",
    ),
    (
        1,
        0,
        Some(1),
        true,
        false,
        "WR",
        "80",
        "@01 0 01 OK IDLE WR 80:85\r\n",
    ),
    (
        1,
        0,
        Some(0),
        true,
        false,
        "WR",
        "50105",
        "@01 0 00 OK IDLE WR 50105:F3\r\n",
    ),
    (
        1,
        0,
        Some(2),
        true,
        false,
        "WR",
        "7.38",
        "@01 0 02 OK IDLE WR 7.38:1C\r\n",
    ),
    (
        1,
        1,
        Some(9),
        true,
        false,
        "WR",
        "51200",
        "@01 1 09 OK IDLE WR 51200:EC\r\n",
    ),
    (
        1,
        1,
        Some(10),
        true,
        false,
        "WR",
        "02 WR WH",
        "@01 1 10 OK IDLE WR 02 WR WH:02\r\n",
    ),
    (
        1,
        1,
        Some(11),
        true,
        true,
        "WR",
        "0",
        "@01 1 11 OK BUSY WR 0:96\r\n",
    ),
    (
        1,
        1,
        Some(12),
        true,
        true,
        "WR",
        "02 WR WH",
        "@01 1 12 OK BUSY WR 02 WR WH:DB\r\n",
    ),
    (
        1,
        1,
        Some(40),
        true,
        true,
        "--",
        "0",
        "@01 1 40 OK BUSY -- 0:E3\r\n",
    ),
];

#[test]
fn commands_are_the_vendors_bytes_both_ways() {
    for (address, axis, id, words, bytes) in COMMANDS {
        let command = command(*address, *axis, *id, words);
        assert_eq!(
            command.encode(true).unwrap(),
            [bytes.as_bytes()],
            "{bytes:?}"
        );
        let packet = decode_command(bytes.trim_end().as_bytes()).unwrap();
        assert_eq!(packet.command, command);
        assert!(packet.checked && !packet.more);
    }
}

#[test]
fn replies_are_the_recorded_bytes_both_ways() {
    for (address, axis, id, accepted, busy, flag, data, bytes) in REPLIES {
        let reply = Reply {
            address: *address,
            axis: *axis,
            id: *id,
            accepted: *accepted,
            activity: if *busy {
                Activity::Busy
            } else {
                Activity::Idle
            },
            flag: Flag::from_code(flag),
            data: (*data).to_owned(),
        };
        assert_eq!(reply.encode(true).unwrap(), bytes.as_bytes(), "{bytes:?}");
        let message = decode_message(bytes.trim_end().as_bytes()).unwrap();
        assert_eq!(message.body, MessageBody::Reply(reply));
        assert!(message.checked && !message.more);
    }
}

#[test]
fn an_alert_and_a_refusal_are_decoded() {
    let message = decode_message(b"!01 1 IDLE --").unwrap();
    let MessageBody::Alert(alert) = message.body else {
        panic!("not an alert")
    };
    assert_eq!((alert.address, alert.axis), (1, 1));
    assert_eq!(alert.encode(false).unwrap(), b"!01 1 IDLE --\r\n");
    let MessageBody::Reply(reply) = decode_message(b"@02 1 33 RJ IDLE -- BADDATA").unwrap().body
    else {
        panic!("not a reply")
    };
    assert!(!reply.accepted);
    assert_eq!(reply.data, "BADDATA");
}

#[test]
fn the_checksum_matches_the_manuals_example() {
    assert_eq!(checksum(b"01 tools echo"), 0x8F);
}

#[test]
fn an_invalid_line_gives_an_error_that_names_the_fault() {
    for (line, expected) in [
        (
            &b"@01 1 09 OK IDLE WR 51201:EC"[..],
            DecodeError::BadChecksum {
                expected: 0xEB,
                found: 0xEC,
            },
        ),
        (
            b"@01 1 09 OK IDLE WR 51200:E",
            DecodeError::ForbiddenByte(b':'),
        ),
        (
            b"@01 1 09 OK IDLE WR 51200:GG",
            DecodeError::BadField("checksum"),
        ),
        (
            b"@1 1 09 OK IDLE WR 51200",
            DecodeError::BadField("device address"),
        ),
        (
            b"@01 1 09 OK IDEL WR 51200",
            DecodeError::BadField("status"),
        ),
        (b"@01 1 09 OK IDLE -- ", DecodeError::BadField("data")),
        (b"@01 1 09 ON IDLE WR 0", DecodeError::BadField("outcome")),
        (
            b"@01 1 09 OK IDLE wr 0",
            DecodeError::BadField("warning flag"),
        ),
        (b"@01 1 09 OK IDLE -- \x07", DecodeError::ForbiddenByte(7)),
        (b"/1 0", DecodeError::NoStart),
        (b"", DecodeError::NoStart),
    ] {
        assert_eq!(
            decode_message(line),
            Err(expected),
            "{}",
            line.escape_ascii()
        );
    }
}

#[test]
fn what_cannot_be_sent_is_refused() {
    for (words, expected) in [
        ("move abs 1:2", EncodeError::ReservedCharacter(':')),
        ("tools echo /", EncodeError::ReservedCharacter('/')),
        ("a\nhome", EncodeError::ReservedCharacter('\n')),
        ("tools echo é", EncodeError::ReservedCharacter('é')),
    ] {
        assert_eq!(command(1, 1, None, words).encode(true), Err(expected));
    }
    let long = "x".repeat(51);
    assert_eq!(
        command(1, 1, None, &long).encode(true),
        Err(EncodeError::WordTooLong(long))
    );
    for (a, b, c) in [(100, 0, None), (1, 10, None), (1, 1, Some(100))] {
        assert!(matches!(
            command(a, b, c, "").encode(true),
            Err(EncodeError::OutOfRange { .. })
        ));
    }
}

#[test]
fn a_long_command_is_split_and_reassembled() {
    let words = format!(
        "tools echo {}",
        (0..30)
            .map(|i| format!("word{i:02}"))
            .collect::<Vec<_>>()
            .join(" ")
    );
    let packets = command(1, 0, Some(7), &words).encode(true).unwrap();
    assert!(packets.len() > 2);
    assert!(packets[0].starts_with(b"/1 0 07 tools echo word00 "));
    assert!(packets[1].starts_with(b"/1 0 07 cont 1 word"));
    let mut assembler = CommandAssembler::default();
    let (last, first) = packets.split_last().unwrap();
    for packet in first {
        assert!(packet.len() <= PACKET_BYTES_MAX);
        let packet = decode_command(packet.trim_ascii_end()).unwrap();
        assert!(packet.more);
        assert_eq!(assembler.accept(packet, 10), Assembled::Pending);
    }
    let whole = assembler.accept(decode_command(last.trim_ascii_end()).unwrap(), 10);
    assert_eq!(whole, Assembled::Whole(command(1, 0, Some(7), &words)));
}

#[test]
fn the_count_of_warnings_is_checked() {
    assert_eq!(decode_warnings("00"), Ok(vec![]));
    assert_eq!(
        decode_warnings("02 WR WH"),
        Ok(vec![Flag::NoReference, Flag::NotHomed])
    );
    for bad in ["", "0", "1 WR", "02 WR", "01 WR WH", "01 ??"] {
        assert!(decode_warnings(bad).is_err(), "{bad:?}");
    }
}

fn text() -> impl Strategy<Value = String> {
    proptest::collection::vec("[a-zA-Z0-9.,;+*=_-]{1,20}", 0..20).prop_map(|words| words.join(" "))
}

fn flag() -> impl Strategy<Value = Option<Flag>> {
    proptest::option::of((0..Flag::ALL.len()).prop_map(|i| Flag::ALL[i]))
}

fn id() -> impl Strategy<Value = Option<u8>> {
    proptest::option::of(0..=99u8)
}

proptest! {
    #![proptest_config(crate::extremes::cases(256))]

    #[test]
    fn any_command_round_trips(
        address in 0..=99u8, axis in 0..=9u8, id in id(), words in text(), with_checksum: bool,
    ) {
        // A leading number would be read as the id and "cont" as a continuation; no command starts
        // so.
        prop_assume!(!words.starts_with(|c: char| c.is_ascii_digit()) && !words.starts_with("cont"));
        let sent = DeviceCommand { address, axis, id, words };
        let packets = sent.encode(with_checksum).unwrap();
        let mut assembler = CommandAssembler::default();
        let mut lines = LineSplitter::of_commands();
        let mut received = Vec::new();
        for packet in &packets {
            prop_assert!(packet.len() <= PACKET_BYTES_MAX);
            for line in lines.push(packet) {
                let packet = decode_command(&line).unwrap();
                prop_assert_eq!(packet.checked, with_checksum);
                received.push(assembler.accept(packet, 100));
            }
        }
        prop_assert_eq!(received.pop(), Some(Assembled::Whole(sent)));
        prop_assert!(received.iter().all(|r| *r == Assembled::Pending));
    }

    #[test]
    fn any_reply_round_trips(
        address in 0..=99u8, axis in 0..=9u8, id in id(), accepted: bool, busy: bool, flag in flag(),
        data in text(), with_checksum: bool,
    ) {
        prop_assume!(!data.is_empty());
        let activity = if busy { Activity::Busy } else { Activity::Idle };
        let sent = Reply { address, axis, id, accepted, activity, flag, data };
        let bytes = sent.encode(with_checksum).unwrap();
        let lines = LineSplitter::of_messages().push(&bytes);
        let mut messages = lines.iter().map(|line| decode_message(line).unwrap());
        let first = messages.next().unwrap();
        let MessageBody::Reply(mut received) = first.body else { panic!("not a reply") };
        for message in messages {
            let MessageBody::Info(info) = message.body else { panic!("not an info") };
            received.data.push(' ');
            received.data.push_str(info.text.strip_prefix(CONTINUED).unwrap());
        }
        prop_assert_eq!(received, sent);
    }

    #[test]
    fn no_bytes_cause_a_panic(bytes: Vec<u8>) {
        let _ = decode_message(&bytes);
        let _ = decode_command(&bytes);
        for line in LineSplitter::of_messages().push(&bytes) {
            let _ = decode_message(&line);
        }
        let mut assembler = CommandAssembler::default();
        for line in LineSplitter::of_commands().push(&bytes) {
            if let Ok(packet) = decode_command(&line) {
                assembler.accept(packet, 3);
            }
        }
    }

    #[test]
    fn no_line_of_protocol_characters_causes_a_panic(line in "[@#!/][0-9 A-Z:\\\\.-]{0,90}") {
        if let Ok(Message { body: MessageBody::Reply(reply), .. }) = decode_message(line.as_bytes()) {
            let _ = decode_warnings(&reply.data);
        }
        let _ = decode_command(line.as_bytes());
    }

    #[test]
    fn any_single_changed_byte_is_detected(at in 1..24usize, by in 1..=255u8) {
        let mut line = b"@01 1 09 OK IDLE WR 51200:EC".to_vec();
        line[at] = line[at].wrapping_add(by);
        prop_assert!(decode_message(&line).is_err());
    }
}
