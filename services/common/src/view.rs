//! Messages seen as core types, in place: the bytes in shared memory are the same, only the type's name changes.

use std::mem::offset_of;

use mirador_core::analysis::PointScore;
use mirador_core::scan::{Grid, Point, ScanView};
use mirador_ipc_schema::messages::{self, ScanMeta};

// The two crates do not know each other; here their layouts are held against each other.
const _: () = {
    assert!(size_of::<Point>() == size_of::<messages::Point>());
    assert!(offset_of!(Point, x) == offset_of!(messages::Point, x));
    assert!(offset_of!(Point, y) == offset_of!(messages::Point, y));
    assert!(offset_of!(Point, z) == offset_of!(messages::Point, z));
    assert!(offset_of!(Point, intensity) == offset_of!(messages::Point, intensity));
    assert!(offset_of!(Point, time) == offset_of!(messages::Point, time));
    assert!(size_of::<PointScore>() == size_of::<messages::PointScore>());
    assert!(offset_of!(PointScore, navigable) == offset_of!(messages::PointScore, navigable));
    assert!(offset_of!(PointScore, obstacle) == offset_of!(messages::PointScore, obstacle));
    assert!(offset_of!(PointScore, quality) == offset_of!(messages::PointScore, quality));
    assert!(offset_of!(PointScore, flags) == offset_of!(messages::PointScore, flags));
    assert!(offset_of!(PointScore, normal_xy) == offset_of!(messages::PointScore, normal_xy));
    assert!(offset_of!(PointScore, area) == offset_of!(messages::PointScore, area));
};

/// A scan message as a scan. A grid that does not fit the number of points is taken for none.
#[must_use]
pub fn scan<'a>(meta: &ScanMeta, points: &'a [messages::Point]) -> ScanView<'a> {
    let points: &[Point] = bytemuck::cast_slice(points);
    let grid = Grid { rows: meta.rows as usize, cols: meta.cols as usize };
    if grid.cells() == 0 {
        return ScanView::unordered(points);
    }
    ScanView::ordered(points, grid).unwrap_or(ScanView::unordered(points))
}

/// The scores of a scored scan.
#[must_use]
pub fn scores(items: &[messages::PointScore]) -> &[PointScore] {
    bytemuck::cast_slice(items)
}

/// The scores of a scored scan, to be written.
pub fn scores_mut(items: &mut [messages::PointScore]) -> &mut [PointScore] {
    bytemuck::cast_slice_mut(items)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_keeps_its_order_and_is_not_copied() {
        let points = [messages::Point::default(); 6];
        let meta = ScanMeta { rows: 2, cols: 3, ..ScanMeta::default() };
        let view = scan(&meta, &points);
        assert_eq!(view.grid, Some(Grid { rows: 2, cols: 3 }));
        assert_eq!(view.points.as_ptr().cast::<u8>(), points.as_ptr().cast::<u8>());
        assert_eq!(scan(&ScanMeta { rows: 2, cols: 4, ..meta }, &points).grid, None);
        assert_eq!(scan(&ScanMeta::default(), &points).grid, None);
    }
}
