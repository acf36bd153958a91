//! Candidate views and zones of interest as things in a scene, each with what is known of it as metadata.

use foxglove::messages::scene_entity_deletion::Type;
use foxglove::messages::{
    ArrowPrimitive, Color, KeyValuePair, Pose, Quaternion, SceneEntity, SceneEntityDeletion, SceneUpdate,
    SpherePrimitive, TextPrimitive,
};
use mirador_core::geometry;
use mirador_ipc_schema::messages::{CANDIDATE_OPEN, CandidateView, ViewPlanMeta, Zone};
use mirador_ipc_schema::text;

use crate::colour::{CHOSEN, Colour, UNKNOWN, ZONE, blue_to_yellow};
use crate::points::{level_pose, timestamp, vector};
use crate::{MAP, Stamps};

/// Most things of a scene; of the candidates those that were valued come first.
const MOST: usize = 1000;

/// Colour of the candidates that were valued, by utility between the least and the greatest; the chosen one apart.
pub(crate) fn candidate_colours(plan: &ViewPlanMeta, candidates: &[CandidateView]) -> Vec<Colour> {
    let open = candidates.iter().filter(|c| c.status == CANDIDATE_OPEN).map(|c| c.utility);
    let (low, high) = (open.clone().fold(f64::INFINITY, f64::min), open.fold(f64::NEG_INFINITY, f64::max));
    let colour = |(k, c): (usize, &CandidateView)| match c.status {
        _ if k == plan.chosen as usize => CHOSEN,
        CANDIDATE_OPEN if high > low => blue_to_yellow((c.utility - low) / (high - low)),
        CANDIDATE_OPEN => blue_to_yellow(1.0),
        _ => UNKNOWN,
    };
    candidates.iter().enumerate().map(colour).collect()
}

/// Every candidate as an arrow in its direction, rejected ones as small balls, with the terms of the decision.
pub(crate) fn candidates(stamps: Stamps, plan: &ViewPlanMeta, candidates: &[CandidateView]) -> SceneUpdate {
    let colours = candidate_colours(plan, candidates);
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by_key(|k| (*k != plan.chosen as usize, candidates[*k].status != CANDIDATE_OPEN, *k));
    let entities = order.into_iter().take(MOST).map(|k| {
        let (candidate, is_chosen) = (&candidates[k], k == plan.chosen as usize);
        let colour = draw_colour(colours[k], 1.0);
        let mut entity = entity(stamps, format!("candidate {k}"), candidate_terms(candidate, is_chosen));
        if candidate.status == CANDIDATE_OPEN {
            let pose = level_pose(candidate.position, candidate.heading);
            entity.arrows.push(arrow(pose, if is_chosen { 1.2 } else { 0.7 }, colour));
        } else {
            let size = Some(vector([0.1; 3]));
            entity.spheres.push(SpherePrimitive {
                pose: Some(level_pose(candidate.position, 0.0)),
                size,
                color: colour,
            });
        }
        if is_chosen {
            let [x, y, z] = candidate.position;
            entity.texts.push(label(format!("u {:.3}", candidate.utility), [x, y, z + 0.6]));
        }
        entity
    });
    anew(stamps, entities.collect())
}

/// The terms of a candidate as they stand in the decision record.
fn candidate_terms(candidate: &CandidateView, is_chosen: bool) -> Vec<KeyValuePair> {
    let number = |key: &str, value: f64| pair(key, format!("{value:.4}"));
    let state = match (is_chosen, candidate.status) {
        (true, _) => "chosen".into(),
        (false, CANDIDATE_OPEN) => "valued".into(),
        (false, _) => format!("rejected: {}", text::unpack(&candidate.reason)),
    };
    vec![
        pair("state", state),
        number("u utility", candidate.utility),
        number("A information", candidate.information),
        number("Q quality", candidate.quality),
        number("O zones", candidate.zones),
        number("C cost", candidate.cost),
        pair("unexplored cells", candidate.unexplored_cells.to_string()),
    ]
}

/// Every zone as an arrow along its normal, as long as the zone is wide.
pub(crate) fn zones(stamps: Stamps, zones: &[Zone]) -> SceneUpdate {
    let entities = zones.iter().take(MOST).enumerate().map(|(k, zone)| {
        let metadata = vec![
            pair("area m^2", format!("{:.3}", zone.area)),
            pair("triangles", zone.triangles.to_string()),
            pair("seen last in scan", zone.scan.to_string()),
            pair("seen from", if zone.merged == 1 { "several scans" } else { "one scan" }.to_owned()),
        ];
        let mut entity = entity(stamps, format!("zone {k}"), metadata);
        let pose = Pose { position: Some(vector(zone.centre.map(f64::from))), orientation: Some(along(zone.normal)) };
        entity.arrows.push(arrow(pose, f64::from(zone.area.max(0.0).sqrt().clamp(0.1, 3.0)), draw_colour(ZONE, 1.0)));
        entity
    });
    anew(stamps, entities.collect())
}

/// The rotation that turns the x axis into this direction; none where there is no direction.
fn along(direction: [f32; 3]) -> Quaternion {
    let x = nalgebra::Vector3::x();
    let to = nalgebra::Vector3::from(direction.map(f64::from));
    let turn = nalgebra::UnitQuaternion::rotation_between(&x, &to).unwrap_or_else(|| {
        nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), std::f64::consts::PI)
    });
    let pose = geometry::Pose::from_parts(nalgebra::Translation3::identity(), turn);
    crate::points::draw_pose(&pose).orientation.unwrap_or_default()
}

/// What takes the place of everything that was drawn on the channel before.
fn anew(stamps: Stamps, entities: Vec<SceneEntity>) -> SceneUpdate {
    let all = SceneEntityDeletion { timestamp: Some(timestamp(stamps)), r#type: Type::All as i32, id: String::new() };
    SceneUpdate { deletions: vec![all], entities }
}

fn entity(stamps: Stamps, id: String, metadata: Vec<KeyValuePair>) -> SceneEntity {
    SceneEntity {
        timestamp: Some(timestamp(stamps)),
        frame_id: MAP.into(),
        id,
        frame_locked: true,
        metadata,
        ..SceneEntity::default()
    }
}

fn arrow(pose: Pose, length: f64, color: Option<Color>) -> ArrowPrimitive {
    ArrowPrimitive {
        pose: Some(pose),
        shaft_length: 0.7 * length,
        shaft_diameter: 0.08,
        head_length: 0.3 * length,
        head_diameter: 0.2,
        color,
    }
}

fn label(text: String, position: [f64; 3]) -> TextPrimitive {
    TextPrimitive {
        pose: Some(level_pose(position, 0.0)),
        billboard: true,
        font_size: 0.4,
        scale_invariant: false,
        color: draw_colour(CHOSEN, 1.0),
        text,
    }
}

fn draw_colour(colour: Colour, alpha: f64) -> Option<Color> {
    let [r, g, b] = colour.map(|c| f64::from(c) / 255.0);
    Some(Color { r, g, b, a: alpha })
}

fn pair(key: &str, value: String) -> KeyValuePair {
    KeyValuePair { key: key.into(), value }
}
