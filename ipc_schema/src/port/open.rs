//! Opening the iceoryx2 services of a topic, with errors that print both sides of a disagreement.

use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use iceoryx2::service::static_config::messaging_pattern::MessagingPattern as Pattern;

use super::Ipc;
use crate::domain::Domain;
use crate::topics::{self, Lag, Topic};

pub(super) type PubSub<T> = publish_subscribe::PortFactory<Ipc, [<T as Topic>::Item], <T as Topic>::Meta>;
pub(super) type Event = event::PortFactory<Ipc>;

/// Most nodes that may open a topic.
const MAX_NODES: usize = 32;

/// Why a topic cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// Another process opened the topic with another layout or other rules.
    #[error(
        "topic '{topic}' exists with another layout: here {here}; there {there}. Build both processes from the same version of mirador"
    )]
    Mismatch {
        /// The topic.
        topic: &'static str,
        /// Layout and rules of this process.
        here: String,
        /// Layout and rules of the one that opened it first.
        there: String,
    },
    /// All places for publishers or subscribers of the topic are taken.
    #[error(
        "topic '{topic}' takes no further {port}: {reason}. Another process holds its place; `mirador doctor` lists them"
    )]
    Full {
        /// The topic.
        topic: &'static str,
        /// "publisher" or "subscriber".
        port: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
    /// `/dev/shm` has no room for the slots.
    #[error(
        "topic '{topic}' cannot get its {bytes} bytes of shared memory: {source}. `mirador doctor` shows the budget"
    )]
    NoMemory {
        /// The topic.
        topic: &'static str,
        /// Bytes of all its slots.
        bytes: u64,
        /// What the system said.
        source: std::io::Error,
    },
    /// Anything else.
    #[error("topic '{topic}' cannot be opened: {reason}")]
    Other {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// The schema hash as it travels in the service's attributes.
fn schema_hash<T: Topic>() -> String {
    format!("{:016x}", topics::schema_hash::<T>())
}

/// The alignment of the slices: as large as the items allow, at most a cache line. iceoryx2 rounds the size of every
/// item up to it, so anything larger would make the slots several times too large.
fn item_alignment<T: Topic>() -> Alignment {
    let largest = 1 << size_of::<T::Item>().trailing_zeros().min(6);
    Alignment::new(largest).unwrap_or(Alignment::ALIGN_1)
}

pub(super) fn pub_sub<T: Topic>(node: &Node<Ipc>, domain: &Domain) -> Result<PubSub<T>, PortError> {
    let rules = T::RULES;
    let other = |reason: String| PortError::Other { topic: rules.name, reason };
    let name: ServiceName = rules.name.try_into().map_err(|e| other(format!("{e:?}")))?;
    let hash = schema_hash::<T>();
    let attributes = AttributeVerifier::new()
        .require(
            &"schema_hash".try_into().map_err(|e| other(format!("{e:?}")))?,
            &hash.as_str().try_into().map_err(|e| other(format!("{e:?}")))?,
        )
        .map_err(|e| other(format!("{e:?}")))?;
    node.service_builder(&name)
        .publish_subscribe::<[T::Item]>()
        .user_header::<T::Meta>()
        .payload_alignment(item_alignment::<T>())
        .max_publishers(rules.publishers)
        .max_subscribers(rules.subscribers)
        .max_nodes(MAX_NODES)
        .subscriber_max_buffer_size(rules.buffer)
        .subscriber_max_borrowed_samples(rules.borrowed)
        .history_size(rules.history)
        .enable_safe_overflow(rules.lag != Lag::Wait)
        .open_or_create_with_attributes(&attributes)
        .map_err(|error| match existing(&name, domain) {
            Some(there) => PortError::Mismatch {
                topic: rules.name,
                here: format!(
                    "{} bytes of meta, {} bytes an item, schema {hash}",
                    size_of::<T::Meta>(),
                    size_of::<T::Item>()
                ),
                there: format!("{there} ({error:?})"),
            },
            None => other(format!("{error:?}")),
        })
}

/// What the process that created the service says of it.
fn existing(name: &ServiceName, domain: &Domain) -> Option<String> {
    let config = domain.config().ok()?;
    let details = Ipc::details(name, &config, MessagingPattern::PublishSubscribe).ok()??;
    let Pattern::PublishSubscribe(config) = details.static_details.messaging_pattern() else { return None };
    let types = config.message_type_details();
    let key = "schema_hash".try_into().ok()?;
    let hash = details
        .static_details
        .attributes()
        .key_value(&key, 0)
        .map_or_else(|| "unknown".to_owned(), |v| format!("{v:?}"));
    Some(format!(
        "{} bytes of meta ({}), {} bytes an item ({}), schema {hash}",
        types.user_header.size(),
        types.user_header.type_name(),
        types.payload.size(),
        types.payload.type_name(),
    ))
}

pub(super) fn event<T: Topic>(node: &Node<Ipc>) -> Result<Event, PortError> {
    let rules = T::RULES;
    let other = |reason: String| PortError::Other { topic: rules.name, reason };
    let name: ServiceName = rules.name.try_into().map_err(|e| other(format!("{e:?}")))?;
    node.service_builder(&name)
        .event()
        // A spare place each: a service that was killed keeps its place until the supervisor has cleaned up.
        .max_notifiers(rules.publishers + 2)
        .max_listeners(rules.subscribers + 2)
        .max_nodes(MAX_NODES)
        .event_id_max_value(1)
        .open_or_create()
        .map_err(|e| other(format!("event: {e:?}")))
}
