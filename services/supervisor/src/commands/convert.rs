//! `mirador convert`.

use std::path::Path;

use anyhow::Result;
use mirador_acquisition::parse_grid;
use mirador_core::formats::{ConvertError, FormatError, WriteError};

use crate::{EXIT_DONE, UsageError, progress};

/// Converts a cloud or a pose file, streaming.
pub fn convert(input: &Path, output: &Path, grid: Option<&str>, quiet: bool) -> Result<u8> {
    let grid = grid.map(parse_grid).transpose().map_err(|e| UsageError(e.to_string()))?;
    let bar = progress::counter("points", quiet);
    let result = mirador_core::formats::convert(input, output, grid, &mut |points| bar.set_position(points));
    bar.finish_and_clear();
    let summary = result.map_err(|error| match error {
        // What only another command line puts right.
        ConvertError::SameFile { .. }
        | ConvertError::GridNeedsPcd { .. }
        | ConvertError::Write(WriteError::UnknownExtension { .. })
        | ConvertError::Read(FormatError::UnknownExtension { .. }) => UsageError(error.to_string()).into(),
        error => anyhow::Error::from(error),
    })?;
    if !quiet {
        println!("{} -> {}: {} read, {} written", input.display(), output.display(), summary.read, summary.written);
    }
    Ok(EXIT_DONE)
}
