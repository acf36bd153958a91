//! The UDP payloads of a capture file, with their times and places in the file.

use std::fs::File;
use std::io::{self, BufReader, Chain, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use etherparse::{SlicedPacket, TransportSlice};
use pcap_parser::traits::{PcapNGPacketBlock, PcapReaderIterator};
use pcap_parser::{Block, Linktype, PcapBlockOwned, PcapError, create_reader};

/// Larger records than this are no packets of a laser.
const BUFFER: usize = 1 << 18;

/// Why a capture cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The system refused to read.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's own reason.
        source: io::Error,
    },
    /// It is not a capture, or damaged.
    #[error("{path}: not a readable capture at byte {byte}: {reason}; expected pcap or pcapng")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
    /// The packets are framed in a way that is not known.
    #[error("{path}: packets of link type {link} cannot be taken apart; capture on Ethernet (1), or as raw IP (101)")]
    LinkType {
        /// The file.
        path: PathBuf,
        /// The number of the link type.
        link: i32,
    },
    /// There is no data packet of a known laser in it.
    #[error("{path}: of {packets} packets none is a data packet of a VLP-16 or HDL-32E (UDP, 1206 bytes){}", rest(.other))]
    NoData {
        /// The file.
        path: PathBuf,
        /// Packets in it.
        packets: u64,
        /// What the packets of the right size were instead; empty when there were none.
        other: String,
    },
    /// There is less than one revolution in it.
    #[error("{path}: holds no whole revolution of the laser")]
    NoRevolution {
        /// The file.
        path: PathBuf,
    },
    /// The file is another one than when it was opened.
    #[error("{path}: changed while it was read")]
    Changed {
        /// The file.
        path: PathBuf,
    },
}

fn rest(other: &str) -> String {
    if other.is_empty() { String::new() } else { format!("; {other}") }
}

/// A packet with a UDP payload.
pub(super) struct Packet<'a> {
    /// Offset of its record in the file.
    pub offset: u64,
    /// When it was captured [ns since 1970 UTC].
    pub stamp_ns: i64,
    pub payload: &'a [u8],
}

/// Framing and time of the packets, as the file's headers say it.
#[derive(Debug, Clone, Copy)]
struct Interface {
    link: Linktype,
    /// Parts of a second that times are counted in.
    resolution: u64,
    offset_s: i64,
}

/// Goes through the packets of a capture.
pub(super) struct Packets {
    path: PathBuf,
    reader: Box<dyn PcapReaderIterator + Send>,
    /// Offset in the file of what the reader says next.
    offset: u64,
    interfaces: Vec<Interface>,
    /// Packets seen, whatever they hold.
    pub seen: u64,
}

impl Packets {
    /// Opens a capture at its beginning.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(|e| io_error(path, e))?;
        Self::over(path, BufReader::new(file), 0)
    }

    /// Opens a capture at a record whose offset is known. `head` is the file up to its first packet.
    pub fn open_at(path: &Path, head: &[u8], offset: u64) -> Result<Self, CaptureError> {
        let mut file = File::open(path).map_err(|e| io_error(path, e))?;
        file.seek(SeekFrom::Start(offset)).map_err(|e| io_error(path, e))?;
        let joined: Chain<Cursor<Vec<u8>>, BufReader<File>> = Cursor::new(head.to_vec()).chain(BufReader::new(file));
        // Offsets are told as in the whole file: those behind the head are shifted.
        let mut packets = Self::over(path, joined, 0)?;
        packets.offset = offset - head.len() as u64;
        Ok(packets)
    }

    fn over(path: &Path, reader: impl Read + Send + 'static, offset: u64) -> Result<Self, CaptureError> {
        let reader = create_reader(BUFFER, reader).map_err(|e| damaged(path, offset, &e))?;
        Ok(Self { path: path.to_owned(), reader, offset, interfaces: Vec::new(), seen: 0 })
    }

    /// Calls `take` with every packet that has a UDP payload, until it says to stop.
    pub fn for_each(&mut self, mut take: impl FnMut(Packet<'_>) -> bool) -> Result<(), CaptureError> {
        let mut refilled_at = None;
        loop {
            match self.reader.next() {
                Ok((length, block)) => {
                    let offset = self.offset;
                    let goes_on = match record(&self.path, &block, &mut self.interfaces)? {
                        Some((interface, stamp_ns, data)) => {
                            self.seen += 1;
                            udp_payload(&self.path, interface.link, data)?
                                .is_none_or(|payload| take(Packet { offset, stamp_ns, payload }))
                        }
                        None => true,
                    };
                    self.reader.consume(length);
                    self.offset += length as u64;
                    if !goes_on {
                        return Ok(());
                    }
                }
                Err(PcapError::Eof) => return Ok(()),
                // A capture that was cut off ends at its last whole packet.
                Err(PcapError::Incomplete(_) | PcapError::UnexpectedEof) if refilled_at == Some(self.offset) => {
                    return Ok(());
                }
                Err(PcapError::Incomplete(_)) => {
                    self.reader.refill().map_err(|e| damaged(&self.path, self.offset, &e))?;
                    if self.reader.reader_exhausted() {
                        refilled_at = Some(self.offset);
                    }
                }
                Err(PcapError::UnexpectedEof) => return Ok(()),
                Err(error) => return Err(damaged(&self.path, self.offset, &error)),
            }
        }
    }
}

fn io_error(path: &Path, source: io::Error) -> CaptureError {
    CaptureError::Io { path: path.to_owned(), source }
}

fn damaged(path: &Path, byte: u64, error: &PcapError<&[u8]>) -> CaptureError {
    CaptureError::Damaged { path: path.to_owned(), byte, reason: reason(error) }
}

fn reason(error: &PcapError<&[u8]>) -> String {
    match error {
        PcapError::HeaderNotRecognized => "it does not begin as one".into(),
        PcapError::BufferTooSmall => "a record is larger than any packet".into(),
        PcapError::ReadError => "reading failed".into(),
        other => format!("{other:?}").chars().take(80).collect(),
    }
}

/// A packet's interface, time [ns since 1970 UTC] and bytes.
type Framed<'a> = (Interface, i64, &'a [u8]);

/// The packet of a block; `None` for other blocks.
fn record<'a>(
    path: &Path,
    block: &'a PcapBlockOwned<'_>,
    interfaces: &mut Vec<Interface>,
) -> Result<Option<Framed<'a>>, CaptureError> {
    match block {
        PcapBlockOwned::LegacyHeader(header) => {
            let resolution = if header.is_nanosecond_precision() { 1_000_000_000 } else { 1_000_000 };
            interfaces.push(Interface { link: header.network, resolution, offset_s: 0 });
            Ok(None)
        }
        PcapBlockOwned::Legacy(packet) => {
            let interface = first(path, interfaces, 0)?;
            let nanoseconds = u64::from(packet.ts_usec) * (1_000_000_000 / interface.resolution);
            Ok(Some((interface, i64::from(packet.ts_sec) * 1_000_000_000 + nanoseconds as i64, packet.data)))
        }
        PcapBlockOwned::NG(Block::SectionHeader(_)) => {
            interfaces.clear();
            Ok(None)
        }
        PcapBlockOwned::NG(Block::InterfaceDescription(about)) => {
            let resolution = about.ts_resolution().filter(|r| *r > 0).unwrap_or(1_000_000);
            interfaces.push(Interface { link: about.linktype, resolution, offset_s: about.ts_offset() });
            Ok(None)
        }
        PcapBlockOwned::NG(Block::EnhancedPacket(packet)) => {
            let interface = first(path, interfaces, packet.if_id as usize)?;
            let ticks = (u64::from(packet.ts_high) << 32) | u64::from(packet.ts_low);
            let nanoseconds = u128::from(ticks) * 1_000_000_000 / u128::from(interface.resolution);
            let stamp = i64::try_from(nanoseconds)
                .unwrap_or(i64::MAX)
                .saturating_add(interface.offset_s.saturating_mul(1_000_000_000));
            Ok(Some((interface, stamp, packet.packet_data())))
        }
        PcapBlockOwned::NG(_) => Ok(None),
    }
}

fn first(path: &Path, interfaces: &[Interface], index: usize) -> Result<Interface, CaptureError> {
    interfaces.get(index).copied().ok_or_else(|| CaptureError::Damaged {
        path: path.to_owned(),
        byte: 0,
        reason: format!("a packet of interface {index}, which is not described"),
    })
}

/// The UDP payload of a packet; `None` for packets of other kinds and damaged ones.
fn udp_payload<'a>(path: &Path, link: Linktype, data: &'a [u8]) -> Result<Option<&'a [u8]>, CaptureError> {
    let sliced = match link {
        Linktype::ETHERNET => SlicedPacket::from_ethernet(data),
        Linktype::LINUX_SLL => SlicedPacket::from_linux_sll(data),
        Linktype::RAW | Linktype::IPV4 | Linktype::IPV6 => SlicedPacket::from_ip(data),
        other => return Err(CaptureError::LinkType { path: path.to_owned(), link: other.0 }),
    };
    Ok(match sliced.ok().and_then(|packet| packet.transport) {
        Some(TransportSlice::Udp(udp)) => Some(udp.payload()),
        _ => None,
    })
}
