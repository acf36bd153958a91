//! Messages about scans, each once and in the order of the scans, whatever is sent again meanwhile.
//!
//! After a restart scans and results come twice: a service asks for its last scan, another repeats its last result.
//! Everybody gets these, also those who did not ask, and a reader that leaves them in its buffer stops the sender.

use std::collections::VecDeque;

use mirador_ipc_schema::messages::Header;
use mirador_ipc_schema::{ReceiveFailure, Received, Subscriber, Topic, Wakeable};

/// The receiving end of a topic with one message a scan. Repetitions are let go at once; a new message is held until it
/// is asked for, as far as the topic's rules allow to hold messages.
pub struct InOrder<T: Topic> {
    port: Subscriber<T>,
    held: VecDeque<Received<T>>,
    newest: Option<u64>,
}

impl<T: Topic> InOrder<T> {
    /// Takes over a port nobody has received from.
    #[must_use]
    pub fn new(port: Subscriber<T>) -> Self {
        Self { port, held: VecDeque::new(), newest: None }
    }

    /// Takes what is there, as long as one more may be held beside `in_use` messages that the service has in its hands.
    ///
    /// # Errors
    /// See [`ReceiveFailure`].
    pub fn fill(&mut self, in_use: usize) -> Result<(), ReceiveFailure> {
        while self.has_room(in_use) {
            let Some(message) = self.port.receive()? else { break };
            if is_new(message.header(), &mut self.newest) {
                self.held.push_back(message);
            }
        }
        Ok(())
    }

    /// Id of the oldest message held.
    #[must_use]
    pub fn front(&self) -> Option<u64> {
        self.held.front().map(|message| message.header().id)
    }

    /// Gives the oldest message away.
    pub fn pop(&mut self) -> Option<Received<T>> {
        self.held.pop_front()
    }

    /// Lets go what is older than the message `id`.
    pub fn discard_before(&mut self, id: u64) {
        while self.front().is_some_and(|front| front < id) {
            self.held.pop_front();
        }
    }

    /// What wakes a service that has taken everything in: nothing while no more can be held, as what then waits in the
    /// buffer would wake it again and again.
    #[must_use]
    pub fn awaited(&self, in_use: usize) -> Option<&dyn Wakeable> {
        self.has_room(in_use).then_some(&self.port as &dyn Wakeable)
    }

    fn has_room(&self, in_use: usize) -> bool {
        self.held.len() + in_use < T::RULES.borrowed
    }
}

/// Whether a message is about a later scan than all before it; it then is the newest.
fn is_new(header: &Header, newest: &mut Option<u64>) -> bool {
    let is_new = newest.is_none_or(|id| header.id > id);
    if is_new {
        *newest = Some(header.id);
    }
    is_new
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repetitions_of_old_messages_are_not_new() {
        let mut newest = None;
        let ids = [4, 5, 4, 5, 6, 5, 9];
        let new = ids.map(|id| is_new(&Header::new(id, 0), &mut newest));
        assert_eq!(new, [true, true, false, false, true, false, true]);
    }
}
