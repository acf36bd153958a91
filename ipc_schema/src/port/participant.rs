//! One process in a domain.

use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;

use super::subscriber::Connect;
use super::{Counters, Ipc, PortError, Publisher, StopSignal, Subscriber};
use crate::domain::{Domain, DomainError};
use crate::topics::{Sizes, Topic};

/// How a process learns that a message is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wake {
    /// It sleeps until the publisher's event wakes it: no load when idle.
    #[default]
    Event,
    /// It looks again and again: the last microseconds, for a whole core.
    Poll,
}

/// Why a process cannot join a domain.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// The domain's folders cannot be used.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The name of the service has characters iceoryx2 does not accept.
    #[error("'{service}' is not a valid service name")]
    BadName {
        /// The name as given.
        service: String,
    },
    /// The iceoryx2 node could not be made.
    #[error("cannot join domain '{domain}' as '{service}': {reason}. `mirador doctor` shows what is in the way")]
    Node {
        /// The domain.
        domain: String,
        /// The service.
        service: String,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// One process in a domain: it opens the ports, waits for messages and counts what its ports do.
#[derive(Debug)]
pub struct Participant {
    pub(super) node: Node<Ipc>,
    pub(super) domain: Domain,
    pub(super) sizes: Sizes,
    pub(super) incarnation: u32,
    pub(super) wake: Wake,
    pub(super) counters: Arc<Counters>,
    pub(super) stop: StopSignal,
    /// The open readers.
    readers: Mutex<Vec<Weak<dyn Connect>>>,
}

impl Participant {
    /// Joins `domain` under the name `service`. `incarnation` counts the starts of the service in this run.
    ///
    /// # Errors
    /// See [`JoinError`].
    pub fn join(
        domain: Domain,
        service: &str,
        incarnation: u32,
        sizes: Sizes,
        wake: Wake,
        stop: StopSignal,
    ) -> Result<Self, JoinError> {
        // iceoryx2 talks on standard error by itself; its findings reach the user through our errors.
        set_log_level(LogLevel::Fatal);
        let config = domain.config()?;
        let name = NodeName::new(service).map_err(|_| JoinError::BadName { service: service.into() })?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|e| JoinError::Node {
                domain: domain.name().into(),
                service: service.into(),
                reason: format!("{e:?}"),
            })?;
        Ok(Self { node, domain, sizes, incarnation, wake, counters: Arc::default(), stop, readers: Mutex::default() })
    }

    /// Opens a topic to send on, all its slots allocated.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, PortError> {
        Publisher::open(self)
    }

    /// Opens a topic to receive from; late joiners get its history.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, PortError> {
        let subscriber = Subscriber::open(self)?;
        let mut readers = self.readers.lock().unwrap_or_else(PoisonError::into_inner);
        readers.retain(|reader| reader.strong_count() > 0);
        readers.push(subscriber.reader());
        Ok(subscriber)
    }

    /// Connects every open reader to the publishers there are now. A reader does so by itself whenever it looks for
    /// messages; one that has never looked gets no more than its buffer holds, whoever waits for it.
    pub fn connect(&self) {
        for reader in self.readers.lock().unwrap_or_else(PoisonError::into_inner).iter().filter_map(Weak::upgrade) {
            reader.connect();
        }
    }

    /// Creates a topic without taking a place in it, so that its rules hold from the start of the graph. The topic
    /// lives as long as the returned handle or any port.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn hold_topic<T: Topic>(&self) -> Result<Box<dyn std::any::Any>, PortError> {
        Ok(Box::new((super::open::pub_sub::<T>(&self.node, &self.domain)?, super::open::event::<T>(&self.node)?)))
    }

    /// What the ports of this process have counted.
    #[must_use]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The domain.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// The sizes the slots were made for.
    #[must_use]
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// The signal that ends this process.
    #[must_use]
    pub fn stop(&self) -> &StopSignal {
        &self.stop
    }

    /// How often this service was started in this run, from 0.
    #[must_use]
    pub fn incarnation(&self) -> u32 {
        self.incarnation
    }

    /// Frees what dead processes of the domain have left; returns how many nodes were cleaned.
    pub fn clean_dead_peers(&self) -> u64 {
        self.node.try_cleanup_dead_nodes().cleanups
    }

    /// The processes of a domain: name, process id and whether they are alive.
    ///
    /// # Errors
    /// When the domain's folders cannot be read.
    pub fn peers(domain: &Domain) -> Result<Vec<Peer>, JoinError> {
        set_log_level(LogLevel::Fatal);
        // To look must not make anything: a folder made here could be taken for one that is in use, or its removal
        // could hit somebody who is just joining.
        if !domain.root().exists() {
            return Ok(Vec::new());
        }
        let config = domain.config_of_existing()?;
        let mut peers = Vec::new();
        let listed = Node::<Ipc>::list(&config, |state| {
            let (details, alive) = match &state {
                NodeState::Alive(view) => (view.details().clone(), true),
                NodeState::Dead(view) => (view.details().clone(), false),
                _ => (None, false),
            };
            let (name, pid) = details.map_or_else(
                || ("unknown".to_owned(), 0),
                |d| (d.name().as_str().to_owned(), u32::try_from(d.process_id().value()).unwrap_or(0)),
            );
            peers.push(Peer { name, pid, alive });
            CallbackProgression::Continue
        });
        listed.map_err(|e| JoinError::Node {
            domain: domain.name().into(),
            service: "list".into(),
            reason: format!("{e:?}"),
        })?;
        Ok(peers)
    }

    /// Waits until one of the ports has something, the time is over or the process should end; when that was.
    pub fn wait(&self, ports: &[&dyn super::Wakeable], timeout: Duration) -> super::Pause {
        super::wait::wait(self.wake, ports, timeout, &self.stop)
    }

    /// As [`Participant::wait`], for messages that are [announced](Publisher::announce): once woken it looks for the message for
    /// a moment, on a core of its own, before it sleeps again.
    pub fn wait_announced(&self, ports: &[&dyn super::Wakeable], timeout: Duration) -> super::Pause {
        super::wait::wait_announced(self.wake, ports, timeout, &self.stop)
    }

    /// Looks for a moment for a message that was announced, without sleeping; whether one is there.
    pub fn look(&self, ports: &[&dyn super::Wakeable]) -> bool {
        super::wait::look(ports, &self.stop)
    }

    /// What waits as this participant does, for a thread that has taken some of the ports.
    #[must_use]
    pub fn waiter(&self) -> Waiter {
        Waiter { wake: self.wake, stop: self.stop.clone() }
    }
}

/// Waits for messages in a thread of its own, see [`Participant::waiter`].
#[derive(Debug, Clone)]
pub struct Waiter {
    wake: Wake,
    stop: StopSignal,
}

impl Waiter {
    /// As [`Participant::wait`].
    pub fn wait(&self, ports: &[&dyn super::Wakeable], timeout: Duration) -> super::Pause {
        super::wait::wait(self.wake, ports, timeout, &self.stop)
    }

    /// The signal that ends the process.
    #[must_use]
    pub fn stop(&self) -> &StopSignal {
        &self.stop
    }
}

/// A process of a domain, dead or alive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Peer {
    /// Name of the service.
    pub name: String,
    /// Process id.
    pub pid: u32,
    /// Whether the process still runs.
    pub alive: bool,
}
