//! What planning says: decisions, paths, and tiles of the map.

use mirador_core::information_map::InformationMap;
use mirador_core::view_planning::ViewPlan;
use mirador_ipc_schema::messages::{CandidateView, Header, MapMeta, MapTile, PathMeta, ViewPlanMeta, Waypoint};
use mirador_ipc_schema::{Participant, Publisher, Topic, topics};
use mirador_service_common::ServiceError;

use crate::figures::Figures;
use crate::messages;

/// The sending end.
pub(crate) struct Outbox {
    plans: Publisher<topics::ViewPlan>,
    paths: Publisher<topics::Path>,
    tiles: Publisher<topics::InformationMap>,
    /// The tiles of a message, before they are sent; reused.
    buffer: Vec<MapTile>,
}

/// Which tiles are sent, and why.
pub(crate) struct TileNews {
    /// Names the scan after which they hold.
    pub header: Header,
    /// Tiles that changed after this revision are sent.
    pub since: u64,
    /// One of the `MAP_CAUSE_*` constants.
    pub cause: u32,
    /// Scans that were moved.
    pub moved_scans: u32,
}

impl Outbox {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            plans: participant.publisher()?,
            paths: participant.publisher()?,
            tiles: participant.publisher()?,
            buffer: Vec::new(),
        })
    }

    pub fn serve_late_joiners(&self) {
        self.plans.serve_late_joiners();
        self.paths.serve_late_joiners();
        self.tiles.serve_late_joiners();
    }

    /// Says again what an earlier incarnation has said last.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn repeat(&self, plan: &[u8], path: &[u8]) -> Result<(), ServiceError> {
        if let Some((meta, items)) = messages::from_bytes::<ViewPlanMeta, CandidateView>(plan) {
            send(&self.plans, meta, &items)?;
        }
        if let Some((meta, items)) = messages::from_bytes::<PathMeta, Waypoint>(path) {
            send(&self.paths, meta, &items)?;
        }
        Ok(())
    }

    /// Sends a decision, and returns it as bytes.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn send_plan(&self, meta: ViewPlanMeta, plan: &ViewPlan) -> Result<Vec<u8>, ServiceError> {
        let count = (plan.candidates.len() + plan.rejected.len()).min(self.plans.capacity());
        let mut loan = self.plans.loan(count)?;
        *loan.meta_mut() = meta;
        messages::write_candidates(plan, loan.items_mut());
        loan.send()?;
        // Written once more for the checkpoint, when the plan is out: nobody waits for that.
        let mut items = vec![CandidateView::default(); count];
        messages::write_candidates(plan, &mut items);
        Ok(messages::to_bytes(&meta, &items))
    }

    /// Sends the way to the chosen view, and returns it as bytes.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn send_path(&self, header: Header, plan: &ViewPlan, map: &InformationMap) -> Result<Vec<u8>, ServiceError> {
        let waypoints = plan.path.get(..plan.path.len().min(self.paths.capacity())).unwrap_or_default();
        let meta = PathMeta {
            header,
            map_revision: plan.map_revision,
            length_m: messages::length(waypoints),
            cost: plan.chosen().map_or(0.0, |c| c.cost),
        };
        let waypoint = |at: &[f64; 3]| Waypoint { position: *at, navigability: messages::navigability_at(map, *at) };
        let items: Vec<_> = waypoints.iter().map(waypoint).collect();
        send(&self.paths, meta, &items)?;
        Ok(messages::to_bytes(&meta, &items))
    }

    /// Sends tiles in as many messages as they need; every tile with all its levels.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn send_tiles(&mut self, map: &InformationMap, figures: &Figures, news: &TileNews) -> Result<(), ServiceError> {
        self.buffer.clear();
        for tile in map.tiles_changed_since(news.since) {
            messages::write_levels(tile, map, &mut self.buffer);
        }
        let capacity = self.tiles.capacity().max(1);
        let parts = self.buffer.chunks(capacity).len() as u32;
        for (part, tiles) in (0..).zip(self.buffer.chunks(capacity)) {
            let meta = MapMeta {
                header: news.header,
                revision: map.revision(),
                cell_m: map.cell_m(),
                tiles_total: map.tile_count() as u32,
                cells_known: figures.cells_known,
                mean_quality: figures.mean_quality,
                bytes: map.bytes() as u64,
                part,
                parts,
                cause: news.cause,
                moved_scans: news.moved_scans,
            };
            send(&self.tiles, meta, tiles)?;
        }
        Ok(())
    }
}

fn send<T: Topic>(publisher: &Publisher<T>, meta: T::Meta, items: &[T::Item]) -> Result<(), ServiceError> {
    let mut loan = publisher.loan(items.len())?;
    *loan.meta_mut() = meta;
    loan.items_mut().copy_from_slice(items);
    Ok(loan.send()?)
}
