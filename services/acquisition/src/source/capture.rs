//! Scans from a capture of a spinning laser's packets.

use mirador_core::formats::Capture;
use mirador_core::scan::Point;

use super::{ScanInfo, Source, SourceError, Written, limited};
use crate::AcquisitionConfig;

/// A `.pcap` or `.pcapng` file: every whole revolution is a scan.
pub(super) struct CaptureSource {
    capture: Capture,
    scans: usize,
}

impl CaptureSource {
    pub(super) fn open(config: &AcquisitionConfig) -> Result<Self, SourceError> {
        let capture = Capture::open(&config.path)?;
        if capture.bad_packets() > 0 {
            let path = config.path.display();
            tracing::warn!(%path, packets = capture.bad_packets(), "damaged packets, or of another laser, are passed over");
        }
        let scans = limited(capture.revolutions().len(), config);
        Ok(Self { capture, scans })
    }
}

impl Source for CaptureSource {
    fn describe(&self) -> String {
        format!("{} revolutions of {}", self.scans, self.capture.path().display())
    }

    fn scans(&self) -> usize {
        self.scans
    }

    fn info(&self, index: usize) -> Option<ScanInfo> {
        let revolution = self.capture.revolutions().get(index).filter(|_| index < self.scans)?;
        Some(ScanInfo { cells: revolution.grid.cells(), stamp_ns: revolution.stamp_ns, prior: None })
    }

    fn write(&mut self, index: usize, out: &mut [Point]) -> Result<Written, SourceError> {
        let missing = SourceError::NoSuchScan { index, scans: self.scans };
        let revolution = self.capture.revolutions().get(index).filter(|_| index < self.scans).ok_or(missing)?;
        self.capture.read(revolution, out)?;
        let (grid, duration_ns) = (Some(revolution.grid), revolution.duration_ns);
        Ok(Written { origin: [0.0; 3], grid, duration_ns, filtered: None })
    }
}
