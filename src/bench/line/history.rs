//! Which commands were sent lately, to explain the replies that answer no open command.

use std::collections::BTreeMap;

use crate::bench::wire::zaber::{DeviceCommand, Reply};

/// A command with its answers.
#[derive(Debug)]
struct SentCommand {
    address: u8,
    axis: u8,
    answers: Vec<Reply>,
}

/// The last command of each message id.
#[derive(Debug, Default)]
pub(super) struct History {
    sent: BTreeMap<u8, SentCommand>,
    newest: Option<u8>,
}

/// Where a reply comes from that answers no open command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stray {
    /// A late or repeated reply to a command of this line.
    Late,
    /// A second, different answer to the newest command: two devices have its address.
    SecondAnswer,
    /// No command of this line explains it.
    Foreign,
}

impl History {
    pub fn sent(&mut self, command: &DeviceCommand) {
        let Some(id) = command.id else { return };
        let entry = SentCommand {
            address: command.address,
            axis: command.axis,
            answers: Vec::new(),
        };
        self.sent.insert(id, entry);
        self.newest = Some(id);
    }

    pub fn answered(&mut self, reply: &Reply) {
        if let Some(sent) = reply.id.and_then(|id| self.sent.get_mut(&id)) {
            sent.answers.push(reply.clone());
        }
    }

    pub fn explain(&self, reply: &Reply) -> Stray {
        let Some(sent) = reply.id.and_then(|id| self.sent.get(&id)) else {
            return Stray::Foreign;
        };
        let is_of_all = sent.address == 0;
        if sent.axis != reply.axis || !(is_of_all || sent.address == reply.address) {
            return Stray::Foreign;
        }
        if is_of_all || sent.answers.is_empty() || sent.answers.contains(reply) {
            return Stray::Late;
        }
        match reply.id == self.newest {
            true => Stray::SecondAnswer,
            false => Stray::Foreign,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::wire::zaber::Activity;

    fn command(address: u8, id: u8) -> DeviceCommand {
        DeviceCommand {
            id: Some(id),
            ..DeviceCommand::new(address, 1, "get pos")
        }
    }

    fn reply(address: u8, id: u8, data: &str) -> Reply {
        Reply {
            address,
            axis: 1,
            id: Some(id),
            accepted: true,
            activity: Activity::Idle,
            flag: None,
            data: data.into(),
        }
    }

    #[test]
    fn late_repeated_second_and_foreign_replies_are_distinguished() {
        let mut history = History::default();
        history.sent(&command(1, 5));
        assert_eq!(history.explain(&reply(1, 5, "7")), Stray::Late);
        history.answered(&reply(1, 5, "7"));
        assert_eq!(history.explain(&reply(1, 5, "7")), Stray::Late);
        assert_eq!(history.explain(&reply(1, 5, "8")), Stray::SecondAnswer);
        assert_eq!(history.explain(&reply(2, 5, "7")), Stray::Foreign);
        assert_eq!(history.explain(&reply(1, 6, "7")), Stray::Foreign);
        history.sent(&command(1, 6));
        assert_eq!(history.explain(&reply(1, 5, "8")), Stray::Foreign);
        // A broadcast has as many answers as devices, also when it is repeated.
        history.sent(&command(0, 7));
        history.answered(&reply(1, 7, "0"));
        assert_eq!(history.explain(&reply(2, 7, "1")), Stray::Late);
        let without_id = Reply {
            id: None,
            ..reply(1, 7, "0")
        };
        assert_eq!(history.explain(&without_id), Stray::Foreign);
    }
}
