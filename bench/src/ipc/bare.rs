//! The bare iceoryx2 API with the settings of the topic that is measured: what our handles are compared with.

use std::time::Duration;

use iceoryx2::node::Node;
use iceoryx2::port::BackpressureAction;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use mirador_ipc_schema::messages::{Point, ScanMeta};
use mirador_ipc_schema::topics::{Lag, Topic};
use mirador_ipc_schema::{Domain, Wake};

use super::BenchError;
use super::topic::MeasuredScan;

/// Name of the two services, so that they are not those of the topic.
const SERVICE: &str = "bench_bare_scan";
/// As many as our ports allow.
const MAX_NODES: usize = 32;
/// Only reached when the subscriber has died.
const BACKPRESSURE_LIMIT: Duration = Duration::from_secs(10);

type PubSub = publish_subscribe::PortFactory<ipc::Service, [Point], ScanMeta>;
type Event = event::PortFactory<ipc::Service>;
pub(super) type BarePublisher = Publisher<ipc::Service, [Point], ScanMeta>;
pub(super) type BareSubscriber = Subscriber<ipc::Service, [Point], ScanMeta>;
pub(super) type BareNotifier = Notifier<ipc::Service>;
pub(super) type BareListener = Listener<ipc::Service>;

/// One process in the domain. Ports keep what they need of it alive by themselves.
pub(super) struct BareNode(Node<ipc::Service>);

impl BareNode {
    /// Joins the domain with its configuration, as our participants do.
    pub fn join(domain: &Domain, name: &str) -> Result<Self, BenchError> {
        set_log_level(LogLevel::Fatal);
        let config = domain.config()?;
        let name = NodeName::new(name).map_err(BenchError::iceoryx("name of the node"))?;
        NodeBuilder::new()
            .name(&name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map(Self)
            .map_err(BenchError::iceoryx("create a node"))
    }

    fn pub_sub(&self) -> Result<PubSub, BenchError> {
        let rules = MeasuredScan::RULES;
        self.0
            .service_builder(&SERVICE.try_into().map_err(BenchError::iceoryx("name of the service"))?)
            .publish_subscribe::<[Point]>()
            .user_header::<ScanMeta>()
            .payload_alignment(Alignment::ALIGN_64)
            .max_publishers(rules.publishers)
            .max_subscribers(rules.subscribers)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(rules.buffer)
            .subscriber_max_borrowed_samples(rules.borrowed)
            .history_size(rules.history)
            .enable_safe_overflow(rules.lag != Lag::Wait)
            .open_or_create()
            .map_err(BenchError::iceoryx("open the service"))
    }

    fn event(&self) -> Result<Event, BenchError> {
        let rules = MeasuredScan::RULES;
        self.0
            .service_builder(&SERVICE.try_into().map_err(BenchError::iceoryx("name of the event"))?)
            .event()
            .max_notifiers(rules.publishers + 2)
            .max_listeners(rules.subscribers + 2)
            .max_nodes(MAX_NODES)
            .event_id_max_value(1)
            .open_or_create()
            .map_err(BenchError::iceoryx("open the event"))
    }

    /// The sending end, and what wakes the subscriber; nothing does when it polls.
    pub fn publisher(&self, points: usize, wake: Wake) -> Result<(BarePublisher, Option<BareNotifier>), BenchError> {
        let publisher = self
            .pub_sub()?
            .publisher_builder()
            .initial_max_slice_len(points)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(MeasuredScan::RULES.loaned)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .set_backpressure_handler(|info| {
                if info.elapsed_time > BACKPRESSURE_LIMIT {
                    return BackpressureAction::DiscardDataAndFail;
                }
                std::thread::sleep(Duration::from_micros(50));
                BackpressureAction::Retry
            })
            .create()
            .map_err(BenchError::iceoryx("create the publisher"))?;
        let notifier = match wake {
            Wake::Poll => None,
            Wake::Event => {
                Some(self.event()?.notifier_builder().create().map_err(BenchError::iceoryx("create the notifier"))?)
            }
        };
        Ok((publisher, notifier))
    }

    /// The receiving end, and what it waits on; nothing when it polls.
    pub fn subscriber(&self, wake: Wake) -> Result<(BareSubscriber, Option<BareListener>), BenchError> {
        let listener = match wake {
            Wake::Poll => None,
            Wake::Event => {
                Some(self.event()?.listener_builder().create().map_err(BenchError::iceoryx("create the listener"))?)
            }
        };
        let subscriber = self
            .pub_sub()?
            .subscriber_builder()
            .buffer_size(MeasuredScan::RULES.buffer)
            .create()
            .map_err(BenchError::iceoryx("create the subscriber"))?;
        Ok((subscriber, listener))
    }
}
