//! Scans from a recording of ours.

use mirador_core::scan::{Grid, Point};
use mirador_ipc_schema::messages::PoseEstimate;
use mirador_ipc_schema::topics;
use mirador_recorder::{ReadError, RunReader};

use super::{Filtered, ScanInfo, Source, SourceError, Written, limited};
use crate::AcquisitionConfig;

/// A run.mcap: the raw scans and their priors, bit for bit.
pub(super) struct RecordingSource {
    reader: RunReader,
    scans: Vec<Recorded>,
}

struct Recorded {
    number: u32,
    info: ScanInfo,
    written: Written,
}

impl RecordingSource {
    pub(super) fn open(config: &AcquisitionConfig) -> Result<Self, SourceError> {
        let mut reader = RunReader::open(&config.path).map_err(unreadable)?;
        let mut priors: Vec<(u64, PoseEstimate)> = Vec::new();
        reader
            .for_each::<topics::Pose>(|meta, items| {
                priors.extend(items.first().map(|estimate| (meta.header.id, *estimate)));
            })
            .map_err(unreadable)?;
        let mut scans = Vec::new();
        reader
            .for_each_meta::<topics::Scan>(|meta, cells| {
                let prior = priors.iter().find(|(id, _)| *id == meta.header.id).map(|(_, estimate)| *estimate);
                let grid = Grid { rows: meta.rows as usize, cols: meta.cols as usize };
                scans.push(Recorded {
                    number: meta.header.scan(),
                    info: ScanInfo { cells, stamp_ns: meta.header.stamp_ns, prior },
                    written: Written {
                        origin: meta.origin,
                        grid: (grid.cells() > 0).then_some(grid),
                        duration_ns: meta.duration_ns,
                        filtered: Some(Filtered {
                            range_min_m: meta.range_min_m,
                            range_max_m: meta.range_max_m,
                            emptied: meta.out_of_range,
                        }),
                    },
                });
            })
            .map_err(unreadable)?;
        if scans.is_empty() {
            return Err(SourceError::Recording(format!("{}: the recording holds no scan", config.path.display())));
        }
        scans.sort_by_key(|s| s.number);
        scans.truncate(limited(scans.len(), config));
        Ok(Self { reader, scans })
    }
}

fn unreadable(error: ReadError) -> SourceError {
    SourceError::Recording(error.to_string())
}

impl Source for RecordingSource {
    fn describe(&self) -> String {
        format!("{} recorded scans of {}", self.scans.len(), self.reader.path().display())
    }

    fn scans(&self) -> usize {
        self.scans.len()
    }

    fn info(&self, index: usize) -> Option<ScanInfo> {
        self.scans.get(index).map(|s| s.info)
    }

    fn write(&mut self, index: usize, out: &mut [Point]) -> Result<Written, SourceError> {
        let scans = self.scans.len();
        let recorded = self.scans.get(index).ok_or(SourceError::NoSuchScan { index, scans })?;
        let mut found = 0;
        self.reader
            .read_scan(recorded.number, &mut |_, points| {
                found = points.len();
                if found == out.len() {
                    out.copy_from_slice(bytemuck::cast_slice(points));
                }
            })
            .map_err(unreadable)?;
        if found != out.len() {
            let path = self.reader.path().to_path_buf();
            return Err(SourceError::CountChanged { path, found, expected: out.len() });
        }
        Ok(recorded.written)
    }
}
