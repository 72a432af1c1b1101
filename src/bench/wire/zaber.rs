//! The Zaber ASCII protocol, firmware 7: commands and messages to bytes and back.
//!
//! ```text
//! command  /[dev [axis [id]]] [word ...][\][:CC]LF
//! reply    @DD A [II] FF SSSS WW data[\][:CC]CRLF   FF = OK|RJ  SSSS = IDLE|BUSY  WW = flag or --
//! info     #DD A [II] text[\][:CC]CRLF              follows a reply, also to continue it
//! alert    !DD A SSSS WW[ data][:CC]CRLF            unasked for
//! ```
//!
//! [`DeviceCommand::encode`] and [`decode_message`] serve the host; [`decode_command`] and
//! [`Reply::encode`] serve the simulated device. [`super::zaber_stream`] assembles byte streams
//! into lines and packets into commands. No input can cause a panic.
//!
//! The checksum is an 8-bit sum. It misses swapped bytes and one in 256 double errors, so the
//! caller still has to check that a position is plausible.

use super::zaber_flags::Flag;

/// Longest packet in bytes, from the start character to the line feed (`comm.packet.size.max`).
pub const PACKET_BYTES_MAX: usize = 80;
/// Longest word in bytes (`comm.word.size.max`).
pub const WORD_BYTES_MAX: usize = 50;
/// Prefix of an info message that continues a reply. Commands number their packets, replies do not
/// (observed: the vendor's client strips only this prefix).
pub const CONTINUED: &str = "cont ";
/// Message ids run from 0 to this.
pub const ID_MAX: u8 = 99;
/// Bytes that may follow a packet's text: `\`, `:CC` and CR LF.
const TAIL_BYTES: usize = 1 + 3 + 2;

/// A command from the host to a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceCommand {
    /// Device 1 to 99; 0 addresses all devices.
    pub address: u8,
    /// Axis 1 to 9; 0 addresses the device itself or all its axes.
    pub axis: u8,
    /// 0 to 99; the reply carries the same id.
    pub id: Option<u8>,
    /// Words separated by single blanks; an empty text asks for the status.
    pub words: String,
}

/// One packet of a command, as the device receives it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandPacket {
    /// Address, axis, id and the words of this packet.
    pub command: DeviceCommand,
    /// Whether the command continues in the next packet.
    pub more: bool,
    /// Whether the packet carried a checksum.
    pub checked: bool,
}

/// Whether any addressed axis is moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activity {
    /// No axis moves.
    Idle,
    /// At least one axis moves.
    Busy,
}

/// The reply to a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// The device that replies.
    pub address: u8,
    /// The axis that the command addressed.
    pub axis: u8,
    /// The command's id, if it had one.
    pub id: Option<u8>,
    /// False if the command was refused; `data` is then the reason.
    pub accepted: bool,
    /// Whether an axis in scope moves.
    pub activity: Activity,
    /// The raised warning flag of highest priority.
    pub flag: Option<Flag>,
    /// The requested value, the reason of a refusal, or `0`.
    pub data: String,
}

/// Text that follows a reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Info {
    /// The device that sends it.
    pub address: u8,
    /// The axis concerned.
    pub axis: u8,
    /// The command's id, if it had one.
    pub id: Option<u8>,
    /// The text.
    pub text: String,
}

/// An unrequested message. It proves nothing: alerts arrive late, twice, or from noise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alert {
    /// The device that sends it.
    pub address: u8,
    /// The axis concerned.
    pub axis: u8,
    /// Whether the axis moves.
    pub activity: Activity,
    /// The raised warning flag of highest priority.
    pub flag: Option<Flag>,
    /// Further data of the device; often empty.
    pub data: String,
}

/// Content of a line from a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MessageBody {
    /// The answer to a command.
    Reply(Reply),
    /// Text that follows a reply.
    Info(Info),
    /// An unrequested message.
    Alert(Alert),
}

/// A line from a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The content.
    pub body: MessageBody,
    /// Whether the next info message continues it.
    pub more: bool,
    /// Whether it carried a checksum (a wrong one is an error).
    pub checked: bool,
}

/// Why a command or message cannot be encoded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// A character that the protocol reserves, or that is not printable ASCII.
    #[error("the character {0:?} cannot be sent: use printable ASCII without / @ # ! : and \\")]
    ReservedCharacter(char),
    /// A word is longer than allowed.
    #[error("the word {0:?} is longer than {WORD_BYTES_MAX} bytes")]
    WordTooLong(String),
    /// An address above 99, an axis above 9 or an id above 99.
    #[error("the {what} {value} is above {max}")]
    OutOfRange {
        /// Name of the number.
        what: &'static str,
        /// Its value.
        value: u8,
        /// Its maximum.
        max: u8,
    },
}

/// Why a line is not a valid message or command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The line lacks a start character.
    #[error("the line does not start with a start character")]
    NoStart,
    /// A byte that is not printable ASCII, or a reserved character inside the line.
    #[error("the line contains the byte 0x{0:02X}, which the protocol does not allow there")]
    ForbiddenByte(u8),
    /// The checksum is wrong: the line was garbled in transmission.
    #[error("expected the checksum {expected:02X}, got {found:02X}: the line was garbled")]
    BadChecksum {
        /// The checksum of the bytes received.
        expected: u8,
        /// The checksum in the line.
        found: u8,
    },
    /// A field is missing or malformed.
    #[error("the {0} is missing or malformed")]
    BadField(&'static str),
}

/// Returns the checksum (LRC) of the bytes between start character and colon: with it, they sum to
/// 0.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u8 {
    bytes
        .iter()
        .fold(0u8, |sum, byte| sum.wrapping_add(*byte))
        .wrapping_neg()
}

impl DeviceCommand {
    /// A command without an id; the sender assigns one.
    #[must_use]
    pub fn new(address: u8, axis: u8, words: impl Into<String>) -> Self {
        DeviceCommand {
            address,
            axis,
            id: None,
            words: words.into(),
        }
    }

    /// Returns the packets to send, one line each, ended by a line feed. A command too long for one
    /// packet continues in packets that begin with `cont 1`, `cont 2` …
    ///
    /// # Errors
    /// [`EncodeError`] for reserved characters, words that are too long, and numbers out of range.
    pub fn encode(&self, with_checksum: bool) -> Result<Vec<Vec<u8>>, EncodeError> {
        check_numbers(self.address, self.axis, self.id)?;
        let prefix = match self.id {
            Some(id) => format!("{} {} {id:02}", self.address, self.axis),
            None => format!("{} {}", self.address, self.axis),
        };
        let texts = split(&self.words, prefix.len(), |n| format!("cont {n} "))?;
        let last = texts.len() - 1;
        Ok(texts
            .into_iter()
            .enumerate()
            .map(|(n, text)| seal(b'/', &prefix, &text, n < last, with_checksum, b"\n"))
            .collect())
    }
}

impl Reply {
    /// Returns the reply's lines, CR LF included; data too long for one line continue in info
    /// messages.
    ///
    /// # Errors
    /// [`EncodeError`] if the data cannot be sent.
    pub fn encode(&self, with_checksum: bool) -> Result<Vec<u8>, EncodeError> {
        check_numbers(self.address, self.axis, self.id)?;
        let outcome = if self.accepted { "OK" } else { "RJ" };
        let from = from_field(self.address, self.axis, self.id);
        let prefix = format!("{from} {outcome} {}", state_field(self.activity, self.flag));
        let texts = split(&self.data, prefix.len(), |_| CONTINUED.to_owned())?;
        let last = texts.len() - 1;
        let mut bytes = Vec::new();
        for (n, text) in texts.into_iter().enumerate() {
            let (start, prefix) = if n == 0 {
                (b'@', &prefix)
            } else {
                (b'#', &from)
            };
            bytes.extend(seal(start, prefix, &text, n < last, with_checksum, b"\r\n"));
        }
        Ok(bytes)
    }
}

impl Info {
    /// Returns the info line, CR LF included.
    ///
    /// # Errors
    /// [`EncodeError`] if the text cannot be sent.
    pub fn encode(&self, with_checksum: bool) -> Result<Vec<u8>, EncodeError> {
        check_numbers(self.address, self.axis, self.id)?;
        check_text(&self.text)?;
        let from = from_field(self.address, self.axis, self.id);
        Ok(seal(b'#', &from, &self.text, false, with_checksum, b"\r\n"))
    }
}

impl Alert {
    /// Returns the alert line, CR LF included.
    ///
    /// # Errors
    /// [`EncodeError`] if the data cannot be sent.
    pub fn encode(&self, with_checksum: bool) -> Result<Vec<u8>, EncodeError> {
        check_numbers(self.address, self.axis, None)?;
        check_text(&self.data)?;
        let from = from_field(self.address, self.axis, None);
        let prefix = format!("{from} {}", state_field(self.activity, self.flag));
        Ok(seal(
            b'!',
            &prefix,
            &self.data,
            false,
            with_checksum,
            b"\r\n",
        ))
    }
}

fn check_numbers(address: u8, axis: u8, id: Option<u8>) -> Result<(), EncodeError> {
    for (what, value, max) in [
        ("device address", address, 99),
        ("axis", axis, 9),
        ("message id", id.unwrap_or(0), ID_MAX),
    ] {
        if value > max {
            return Err(EncodeError::OutOfRange { what, value, max });
        }
    }
    Ok(())
}

fn is_text(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte) && !b"/@#!:\\".contains(&byte)
}

fn check_text(text: &str) -> Result<(), EncodeError> {
    match text.chars().find(|c| !c.is_ascii() || !is_text(*c as u8)) {
        Some(c) => Err(EncodeError::ReservedCharacter(c)),
        None => Ok(()),
    }
}

/// Splits words into texts that fit behind a prefix; later ones begin with `continuation(1, 2 …)`.
fn split(
    words: &str,
    prefix_bytes: usize,
    continuation: impl Fn(usize) -> String,
) -> Result<Vec<String>, EncodeError> {
    check_text(words)?;
    // Start character, prefix, a blank.
    let room = PACKET_BYTES_MAX.saturating_sub(1 + prefix_bytes + 1 + TAIL_BYTES);
    let mut texts = vec![String::new()];
    let mut fresh = true;
    for word in words.split_ascii_whitespace() {
        if word.len() > WORD_BYTES_MAX {
            return Err(EncodeError::WordTooLong(word.to_owned()));
        }
        let packets = texts.len();
        let text = texts.last_mut().expect("there is always one");
        if !fresh && text.len() + 1 + word.len() > room {
            texts.push(continuation(packets) + word);
            continue;
        }
        if !text.is_empty() {
            text.push(' ');
        }
        text.push_str(word);
        fresh = false;
    }
    Ok(texts)
}

fn from_field(address: u8, axis: u8, id: Option<u8>) -> String {
    match id {
        Some(id) => format!("{address:02} {axis} {id:02}"),
        None => format!("{address:02} {axis}"),
    }
}

fn state_field(activity: Activity, flag: Option<Flag>) -> String {
    let activity = match activity {
        Activity::Idle => "IDLE",
        Activity::Busy => "BUSY",
    };
    match flag {
        Some(flag) => format!("{activity} {flag}"),
        None => format!("{activity} --"),
    }
}

fn seal(
    start: u8,
    prefix: &str,
    text: &str,
    more: bool,
    with_checksum: bool,
    end: &[u8],
) -> Vec<u8> {
    let mut line = vec![start];
    line.extend_from_slice(prefix.as_bytes());
    if !text.is_empty() {
        line.push(b' ');
        line.extend_from_slice(text.as_bytes());
    }
    if more {
        line.push(b'\\');
    }
    if with_checksum {
        let sum = checksum(&line[1..]);
        line.extend_from_slice(format!(":{sum:02X}").as_bytes());
    }
    line.extend_from_slice(end);
    line
}

/// A line without its start character and tail, both checked.
struct Opened<'a> {
    text: &'a str,
    more: bool,
    checked: bool,
}

fn open(line: &[u8]) -> Result<Opened<'_>, DecodeError> {
    let mut rest = line;
    let mut checked = false;
    if let [before @ .., b':', high, low] = line {
        let digits = [*high, *low];
        let found = std::str::from_utf8(&digits)
            .ok()
            .filter(|_| digits.iter().all(u8::is_ascii_hexdigit))
            .and_then(|hex| u8::from_str_radix(hex, 16).ok())
            .ok_or(DecodeError::BadField("checksum"))?;
        let expected = checksum(before);
        if found != expected {
            return Err(DecodeError::BadChecksum { expected, found });
        }
        rest = before;
        checked = true;
    }
    let more = rest.last() == Some(&b'\\');
    if more {
        rest = &rest[..rest.len() - 1];
    }
    if let Some(byte) = rest.iter().find(|byte| !is_text(**byte) && **byte != b'\t') {
        return Err(DecodeError::ForbiddenByte(*byte));
    }
    let text = std::str::from_utf8(rest).map_err(|_| DecodeError::BadField("text"))?;
    Ok(Opened {
        text,
        more,
        checked,
    })
}

/// Removes the next word from the front and returns it.
fn word<'a>(rest: &mut &'a str) -> Option<&'a str> {
    *rest = rest.trim_start();
    if rest.is_empty() {
        return None;
    }
    let end = rest.find([' ', '\t']).unwrap_or(rest.len());
    let (word, after) = rest.split_at(end);
    *rest = after;
    Some(word)
}

fn digits(word: Option<&str>, width: usize, what: &'static str) -> Result<u8, DecodeError> {
    word.filter(|w| w.len() == width && w.bytes().all(|b| b.is_ascii_digit()))
        .and_then(|w| w.parse().ok())
        .ok_or(DecodeError::BadField(what))
}

/// Removes a two-digit id from the front if there is one (`--` counts as none).
fn maybe_id(rest: &mut &str) -> Option<u8> {
    let mut ahead = *rest;
    let next = word(&mut ahead)?;
    if next == "--" {
        *rest = ahead;
        return None;
    }
    let id = digits(Some(next), 2, "message id").ok()?;
    *rest = ahead;
    Some(id)
}

fn state(rest: &mut &str) -> Result<(Activity, Option<Flag>), DecodeError> {
    let activity = match word(rest) {
        Some("IDLE") => Activity::Idle,
        Some("BUSY") => Activity::Busy,
        _ => return Err(DecodeError::BadField("status")),
    };
    let flag = match word(rest) {
        Some("--") => None,
        Some(code) => Some(Flag::from_code(code).ok_or(DecodeError::BadField("warning flag"))?),
        None => return Err(DecodeError::BadField("warning flag")),
    };
    Ok((activity, flag))
}

/// Decodes a line from a device, without its line end.
///
/// # Errors
/// [`DecodeError`]: treat the line as never received.
pub fn decode_message(line: &[u8]) -> Result<Message, DecodeError> {
    let (start, rest) = line.split_first().ok_or(DecodeError::NoStart)?;
    if !b"@#!".contains(start) {
        return Err(DecodeError::NoStart);
    }
    let opened = open(rest)?;
    let mut rest = opened.text;
    let address = digits(word(&mut rest), 2, "device address")?;
    let axis = digits(word(&mut rest), 1, "axis")?;
    let body = match start {
        b'@' => {
            let id = maybe_id(&mut rest);
            let accepted = match word(&mut rest) {
                Some("OK") => true,
                Some("RJ") => false,
                _ => return Err(DecodeError::BadField("outcome")),
            };
            let (activity, flag) = state(&mut rest)?;
            let data = rest.trim();
            if data.is_empty() {
                return Err(DecodeError::BadField("data"));
            }
            MessageBody::Reply(Reply {
                address,
                axis,
                id,
                accepted,
                activity,
                flag,
                data: data.to_owned(),
            })
        }
        b'#' => MessageBody::Info(Info {
            address,
            axis,
            id: maybe_id(&mut rest),
            text: rest.trim().to_owned(),
        }),
        _ => {
            let (activity, flag) = state(&mut rest)?;
            MessageBody::Alert(Alert {
                address,
                axis,
                activity,
                flag,
                data: rest.trim().to_owned(),
            })
        }
    };
    Ok(Message {
        body,
        more: opened.more,
        checked: opened.checked,
    })
}

/// Decodes a line from a host, without its line end. Up to three leading numbers are address, axis
/// and id.
///
/// # Errors
/// [`DecodeError`]: the device executes nothing and stays silent.
pub fn decode_command(line: &[u8]) -> Result<CommandPacket, DecodeError> {
    let Some((b'/', rest)) = line.split_first() else {
        return Err(DecodeError::NoStart);
    };
    let opened = open(rest)?;
    let mut rest = opened.text;
    let mut number = |max: u8, what| -> Result<Option<u8>, DecodeError> {
        let mut ahead = rest;
        match word(&mut ahead) {
            Some(w) if w.bytes().all(|b| b.is_ascii_digit()) => {
                rest = ahead;
                let n: u8 = w.parse().map_err(|_| DecodeError::BadField(what))?;
                if n > max {
                    return Err(DecodeError::BadField(what));
                }
                Ok(Some(n))
            }
            _ => Ok(None),
        }
    };
    let address = number(99, "device address")?;
    let axis = match address {
        Some(_) => number(9, "axis")?,
        None => None,
    };
    let id = match axis {
        Some(_) => number(ID_MAX, "message id")?,
        None => None,
    };
    Ok(CommandPacket {
        command: DeviceCommand {
            address: address.unwrap_or(0),
            axis: axis.unwrap_or(0),
            id,
            words: rest.split_ascii_whitespace().collect::<Vec<_>>().join(" "),
        },
        more: opened.more,
        checked: opened.checked,
    })
}

/// Decodes the reply to `warnings`: a count of two digits, then that many flags.
///
/// # Errors
/// [`DecodeError::BadField`] if count and flags disagree.
pub fn decode_warnings(data: &str) -> Result<Vec<Flag>, DecodeError> {
    let mut rest = data;
    let count = digits(word(&mut rest), 2, "count of warnings")?;
    let flags: Vec<Flag> = rest
        .split_ascii_whitespace()
        .map(|code| Flag::from_code(code).ok_or(DecodeError::BadField("warning flag")))
        .collect::<Result<_, _>>()?;
    if flags.len() != usize::from(count) {
        return Err(DecodeError::BadField("count of warnings"));
    }
    Ok(flags)
}

#[cfg(test)]
#[path = "zaber_tests.rs"]
mod tests;
