//! The WebSocket that viewers connect to.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    Context, Encode, FoxgloveError, PartialMetadata, RawChannel, SinkId, WebSocketServer, WebSocketServerHandle,
};
use mirador_viewers::{CHANNELS, Sink, Stamps};
use tokio::runtime::Runtime;

use crate::GatewayConfig;

/// A port that is taken is tried again after this long.
const TRY_AGAIN: Duration = Duration::from_secs(2);
/// A drawing is said to be unfit once in this time.
const COMPLAIN: Duration = Duration::from_secs(10);

/// Who has subscribed to what and was not shown the present state of it yet.
type Newcomers = Arc<Mutex<Vec<(SinkId, String)>>>;

/// Serves drawings to viewers.
pub(crate) struct Server {
    config: GatewayConfig,
    name: String,
    context: Arc<Context>,
    channels: BTreeMap<&'static str, Arc<RawChannel>>,
    newcomers: Newcomers,
    handle: Option<WebSocketServerHandle>,
    tried: Option<Instant>,
    scratch: Vec<u8>,
    complained: Option<Instant>,
    /// Last, so that what runs in it is dropped before.
    runtime: Runtime,
}

/// What came of trying to listen.
pub(crate) enum Listening {
    /// Nothing has changed.
    AsBefore,
    /// Viewers can connect now, to this port.
    At(u16),
    /// They cannot, for this reason; it is tried again.
    Failed(String),
}

impl Server {
    /// Makes the channels; nobody can connect before [`Self::listen`].
    ///
    /// # Errors
    /// The system gives no thread, or a channel is made twice.
    pub(crate) fn new(name: &str, config: &GatewayConfig) -> Result<Self, String> {
        // One thread: what it does is to hand bytes to sockets.
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("viewers")
            .enable_io()
            .enable_time()
            .build()
            .map_err(|e| format!("the thread for viewers cannot be started: {e}"))?;
        let context = Context::new();
        let mut channels = BTreeMap::new();
        for channel in CHANNELS {
            let (schema, encoding) = (channel.declaration)();
            let made = context.channel_builder(channel.topic).schema(schema).message_encoding(encoding).build_raw();
            channels.insert(channel.topic, made.map_err(|e| format!("channel {}: {e}", channel.topic))?);
        }
        Ok(Self {
            config: config.clone(),
            name: name.to_owned(),
            context,
            channels,
            newcomers: Newcomers::default(),
            handle: None,
            tried: None,
            scratch: Vec::new(),
            complained: None,
            runtime,
        })
    }

    /// Begins to listen, unless it does already or has just failed to.
    pub(crate) fn listen(&mut self) -> Listening {
        if self.handle.is_some() || self.tried.is_some_and(|at| at.elapsed() < TRY_AGAIN) {
            return Listening::AsBefore;
        }
        self.tried = Some(Instant::now());
        let server = WebSocketServer::new()
            .name(&self.name)
            .bind("127.0.0.1", self.config.port)
            .context(&self.context)
            .message_backlog_size(self.config.backlog)
            .listener(Arc::new(Doorman(self.newcomers.clone())));
        match self.runtime.block_on(server.start()) {
            Ok(handle) => Listening::At(self.handle.insert(handle).port()),
            Err(error) => Listening::Failed(self.cause(error)),
        }
    }

    fn cause(&self, error: FoxgloveError) -> String {
        let place = format!("127.0.0.1:{}", self.config.port);
        match error {
            FoxgloveError::Bind(e) if e.kind() == io::ErrorKind::AddrInUse => {
                format!(
                    "port {place} is taken by another program: end it, or set gateway.port to another; it is tried again"
                )
            }
            FoxgloveError::Bind(e) => format!("{place} cannot be listened on: {e}; it is tried again"),
            e => format!("viewers cannot be served: {e}; it is tried again"),
        }
    }

    /// Who has subscribed to which channel since this was asked last.
    pub(crate) fn newcomers(&self) -> Vec<(SinkId, String)> {
        std::mem::take(&mut self.newcomers.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Number of clients.
    pub(crate) fn clients(&self) -> usize {
        self.handle.as_ref().map_or(0, WebSocketServerHandle::client_count)
    }

    /// Draws for one client only.
    pub(crate) fn only_for(&mut self, client: SinkId) -> OnlyFor<'_> {
        OnlyFor { server: self, client }
    }

    fn send<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M, to: Option<SinkId>) {
        let Some(known) = self.channels.get(channel) else { return };
        self.scratch.clear();
        match message.encode(&mut self.scratch) {
            Ok(()) => known.log_with_meta_to_sink(&self.scratch, PartialMetadata::with_log_time(stamps.log_time), to),
            Err(error) if self.complained.is_none_or(|at| at.elapsed() > COMPLAIN) => {
                self.complained = Some(Instant::now());
                tracing::warn!(channel, %error, "a drawing cannot be encoded");
            }
            Err(_) => {}
        }
    }

    /// Says goodbye to all clients.
    pub(crate) fn stop(self) {
        if let Some(handle) = self.handle {
            drop(handle.stop());
        }
        self.runtime.shutdown_timeout(Duration::from_millis(200));
    }
}

impl Sink for Server {
    type Error = std::convert::Infallible;

    fn wants(&self, channel: &'static str) -> bool {
        self.channels.get(channel).is_some_and(|known| known.has_sinks())
    }

    fn draw<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M) -> Result<(), Self::Error> {
        self.send(channel, stamps, message, None);
        Ok(())
    }
}

/// The server as one client sees it.
pub(crate) struct OnlyFor<'a> {
    server: &'a mut Server,
    client: SinkId,
}

impl Sink for OnlyFor<'_> {
    type Error = std::convert::Infallible;

    fn wants(&self, _channel: &'static str) -> bool {
        true
    }

    fn draw<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M) -> Result<(), Self::Error> {
        self.server.send(channel, stamps, message, Some(self.client));
        Ok(())
    }
}

/// Notes who subscribes.
struct Doorman(Newcomers);

impl ServerListener for Doorman {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        if let Some(client) = client.sink_id() {
            let mut newcomers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            newcomers.push((client, channel.topic().to_owned()));
        }
    }
}
