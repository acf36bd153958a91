//! Figures that were not measured in this run: peers that do not come from PyPI, or take too long.

use std::collections::BTreeMap;

use serde_json::json;

use crate::{Provenance, Row, Summary};

/// Where they come from.
const SOURCE: &str = "measured once in November 2026 on 2 vCPUs at 2.5 GHz; files of text as input for 3DTK";

/// A whole run over the 45 handheld scans.
struct Figure {
    method: &'static str,
    prior: &'static str,
    ms: f64,
    ate_rmse_m: f64,
    ate_rmse_deg: Option<f64>,
}

const HANDHELD: [Figure; 9] = [
    figure("3DTK ICP", 13_400.0, 0.087, 0.59),
    figure("3DTK metascan of 10", 57_000.0, 0.100, 0.33),
    figure("3DTK ICP + ELCH", 32_000.0, 0.531, 1.21),
    figure("3DTK ICP + LUM", 15_300.0, 0.076, 0.27),
    figure("3DTK ICP + ELCH + LUM", 25_200.0, 0.074, 0.28),
    figure("small_gicp GICP chain", 3_700.0, 0.131, 0.21),
    figure("small_gicp PLANE_ICP chain", 4_900.0, 0.130, 0.63),
    figure("small_gicp VGICP chain", 2_800.0, 0.130, 0.22),
    Figure { method: "kiss_icp", prior: "none", ms: 48_150.0, ate_rmse_m: 6.05, ate_rmse_deg: None },
];

const fn figure(method: &'static str, ms: f64, ate_rmse_m: f64, ate_rmse_deg: f64) -> Figure {
    Figure { method, prior: "odometry", ms, ate_rmse_m, ate_rmse_deg: Some(ate_rmse_deg) }
}

/// Number of scans of the handheld sequence.
const SCANS: usize = 45;

/// `sequence` rows of the literature.
pub(super) fn handheld_rows() -> Vec<Row> {
    HANDHELD.iter().map(row).collect()
}

fn row(figure: &Figure) -> Row {
    Row {
        name: "sequence".into(),
        params: BTreeMap::from([
            ("method".to_owned(), json!(figure.method)),
            ("data".into(), json!("handheld")),
            ("peer".into(), json!(true)),
            ("prior".into(), json!(figure.prior)),
            ("per".into(), json!("sequence")),
        ]),
        unit: "ms".into(),
        summary: Summary::single(figure.ms),
        provenance: Provenance::Literature,
        extra: BTreeMap::from([
            ("scans".to_owned(), json!(SCANS)),
            ("ms_per_scan".into(), json!(figure.ms / SCANS as f64)),
            ("ate_rmse_m".into(), json!(figure.ate_rmse_m)),
            ("ate_rmse_deg".into(), json!(figure.ate_rmse_deg)),
            ("source".into(), json!(SOURCE)),
        ]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literature_says_so_and_names_its_source() {
        let rows = handheld_rows();
        assert!(rows.iter().all(|row| row.provenance == Provenance::Literature && row.extra.contains_key("source")));
        let lum = rows.iter().find(|row| row.params["method"] == "3DTK ICP + LUM").unwrap();
        assert_eq!((lum.summary.p50, &lum.extra["ms_per_scan"]), (15_300.0, &json!(340.0)));
    }
}
