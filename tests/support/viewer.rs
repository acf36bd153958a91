//! A viewer for the tests: Foxglove's protocol over a real WebSocket.

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// The longest an expected message may keep a test waiting.
const PATIENCE: Duration = Duration::from_secs(30);

/// A client that has subscribed to every channel.
pub struct Viewer {
    socket: WebSocket<TcpStream>,
    /// Channel and schema by number of the subscription.
    channels: BTreeMap<u32, (String, String)>,
}

impl Viewer {
    /// Connects, reads what is offered and subscribes to everything.
    pub fn connect(port: u16) -> Self {
        let mut request = format!("ws://127.0.0.1:{port}").into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, response) = tungstenite::client(request, stream).unwrap();
        assert_eq!(response.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
        let mut viewer = Self { socket, channels: BTreeMap::new() };
        let offered = viewer.text("advertise");
        let mut subscriptions = Vec::new();
        for (id, channel) in (0..).zip(offered["channels"].as_array().unwrap()) {
            let word = |key: &str| channel[key].as_str().unwrap().to_owned();
            viewer.channels.insert(id, (word("topic"), word("schemaName")));
            subscriptions.push(json!({ "id": id, "channelId": channel["id"] }));
        }
        assert!(viewer.say(Message::text(json!({ "op": "subscribe", "subscriptions": subscriptions }).to_string())));
        viewer
    }

    /// Says something; whether the server still takes it.
    pub fn say(&mut self, message: Message) -> bool {
        self.socket.send(message).is_ok()
    }

    /// Names and schemas of the channels that are offered.
    pub fn offered(&self) -> BTreeMap<String, String> {
        self.channels.values().cloned().collect()
    }

    /// The next text message with this `op`.
    pub fn text(&mut self, op: &str) -> Value {
        let began = Instant::now();
        loop {
            assert!(began.elapsed() < PATIENCE, "never came: {op}");
            if let Message::Text(text) = self.socket.read().unwrap() {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["op"] == op {
                    return value;
                }
            }
        }
    }

    /// The next drawing: its channel, its log time [ns] and its bytes; `None` once the server has gone.
    pub fn next(&mut self) -> Option<(String, u64, Vec<u8>)> {
        loop {
            // Operation (u8), subscription (u32), log time (u64), then the message, as the protocol's specification says.
            if let Message::Binary(bytes) = self.socket.read().ok()?
                && bytes[0] == 1
            {
                let (channel, _) = &self.channels[&u32::from_le_bytes(bytes[1..5].try_into().unwrap())];
                let time = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                return Some((channel.clone(), time, bytes[13..].to_vec()));
            }
        }
    }

    /// The next drawing on a channel: its log time [ns] and its bytes.
    pub fn drawing(&mut self, channel: &str) -> (u64, Vec<u8>) {
        let began = Instant::now();
        loop {
            assert!(began.elapsed() < PATIENCE, "never came: {channel}");
            let (on, time, bytes) = self.next().unwrap_or_else(|| panic!("the server has gone before {channel}"));
            if on == channel {
                return (time, bytes);
            }
        }
    }
}
