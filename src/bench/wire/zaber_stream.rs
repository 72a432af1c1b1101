//! Assembles byte streams into lines, and packets into whole commands (Zaber ASCII protocol).

use super::zaber::{CommandPacket, DeviceCommand, PACKET_BYTES_MAX};

/// A longer line is noise: three times the longest packet.
const LINE_BYTES_MAX: usize = 3 * PACKET_BYTES_MAX;

/// Assembles the packets of a long command, on the device's side.
#[derive(Debug, Default)]
pub struct CommandAssembler {
    pending: Option<(DeviceCommand, u32)>,
}

/// Result of adding a packet to a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Assembled {
    /// The command is complete.
    Whole(DeviceCommand),
    /// More packets must follow.
    Pending,
    /// The packet does not continue the previous ones: `BADSPLIT`.
    BadSplit(DeviceCommand),
}

impl CommandAssembler {
    /// Adds the next packet; `packets_max` is the largest number of packets of a command.
    pub fn accept(&mut self, packet: CommandPacket, packets_max: u32) -> Assembled {
        let CommandPacket { command, more, .. } = packet;
        let continuation = command.words.strip_prefix("cont ").map(str::to_owned);
        let (whole, packets) = match (self.pending.take(), continuation) {
            (None, None) => (command, 1),
            // A command without a continuation prefix starts a new one; an unfinished one is
            // dropped.
            (Some(_), None) => (command, 1),
            (None, Some(_)) => return Assembled::BadSplit(command),
            (Some((mut whole, packets)), Some(text)) => {
                let (number, words) = text.split_once(' ').unwrap_or((text.as_str(), ""));
                let same = (whole.address, whole.axis, whole.id)
                    == (command.address, command.axis, command.id);
                if !same || number.parse() != Ok(packets) || packets >= packets_max {
                    return Assembled::BadSplit(command);
                }
                if !words.is_empty() {
                    whole.words.push(' ');
                    whole.words.push_str(words);
                }
                (whole, packets + 1)
            }
        };
        if more {
            self.pending = Some((whole, packets));
            Assembled::Pending
        } else {
            Assembled::Whole(whole)
        }
    }
}

/// Splits a byte stream into lines. A start character inside a line begins a new one: no text
/// contains one, so a lost line end costs one message instead of two.
#[derive(Debug)]
pub struct LineSplitter {
    starts: &'static [u8],
    line: Vec<u8>,
    in_line: bool,
    fragments: u64,
}

impl LineSplitter {
    /// For lines sent by devices.
    #[must_use]
    pub fn of_messages() -> Self {
        Self::starting_with(b"@#!")
    }

    /// For lines sent by hosts.
    #[must_use]
    pub fn of_commands() -> Self {
        Self::starting_with(b"/")
    }

    fn starting_with(starts: &'static [u8]) -> Self {
        LineSplitter {
            starts,
            line: Vec::new(),
            in_line: false,
            fragments: 0,
        }
    }

    /// Adds bytes and returns the lines that they complete, without line ends.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut whole = Vec::new();
        for &byte in bytes {
            if self.starts.contains(&byte) {
                self.fragments += u64::from(self.in_line);
                self.line.clear();
                self.line.push(byte);
                self.in_line = true;
            } else if byte == b'\r' || byte == b'\n' {
                if self.in_line {
                    whole.push(std::mem::take(&mut self.line));
                }
                self.in_line = false;
            } else if self.in_line {
                if self.line.len() == LINE_BYTES_MAX {
                    self.fragments += 1;
                    self.in_line = false;
                } else {
                    self.line.push(byte);
                }
            }
        }
        whole
    }

    /// Drops an unfinished line.
    pub fn clear(&mut self) {
        self.fragments += u64::from(self.in_line);
        self.in_line = false;
        self.line.clear();
    }

    /// Number of lines that began and never ended.
    #[must_use]
    pub fn fragments(&self) -> u64 {
        self.fragments
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::wire::zaber::decode_command;

    #[test]
    fn packets_out_of_order_are_a_bad_split() {
        let mut assembler = CommandAssembler::default();
        let mut accept = |line: &str| assembler.accept(decode_command(line.as_bytes()).unwrap(), 3);
        assert!(matches!(accept("/1 0 07 cont 1 a"), Assembled::BadSplit(_)));
        assert_eq!(accept("/1 0 07 tools echo a\\"), Assembled::Pending);
        assert!(matches!(accept("/1 0 07 cont 2 b"), Assembled::BadSplit(_)));
        assert_eq!(accept("/1 0 07 tools echo a\\"), Assembled::Pending);
        assert!(matches!(accept("/1 0 08 cont 1 b"), Assembled::BadSplit(_)));
        // Three packets are allowed, a fourth is not.
        assert_eq!(accept("/1 0 07 tools echo a\\"), Assembled::Pending);
        assert_eq!(accept("/1 0 07 cont 1 b\\"), Assembled::Pending);
        assert_eq!(accept("/1 0 07 cont 2 c\\"), Assembled::Pending);
        assert!(matches!(accept("/1 0 07 cont 3 d"), Assembled::BadSplit(_)));
    }

    #[test]
    fn a_lost_line_end_costs_one_message() {
        let mut lines = LineSplitter::of_messages();
        let whole =
            lines.push(b"noise\r\n@01 1 09 OK IDLE -- 5@01 1 10 OK IDLE -- 6\r\n\r\n!01 1 ID");
        assert_eq!(whole, [b"@01 1 10 OK IDLE -- 6"]);
        assert_eq!(lines.fragments(), 1);
        assert_eq!(lines.push(b"LE --\n"), [b"!01 1 IDLE --"]);
    }

    #[test]
    fn endless_noise_takes_no_memory() {
        let mut lines = LineSplitter::of_messages();
        for _ in 0..100 {
            assert!(lines.push(&[b'@'; 3]).is_empty());
            assert!(lines.push(&[b'x'; 1000]).is_empty());
        }
        assert!(lines.line.capacity() <= 2 * LINE_BYTES_MAX);
    }
}
