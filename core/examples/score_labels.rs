//! How well the scores tell ground from obstacles, on labelled scans that were not used to calibrate them.
//!
//!     cargo run --release -p mirador-core --example score_labels
//!
//! Prints one line a scene and trial: precision and recall of navigable and of obstacle cells within 15 m.

use std::error::Error;

#[path = "../tests/labelled/mod.rs"]
#[allow(dead_code)]
mod labelled;

use labelled::{HEAD, Judgement, SCENES, Trial, judge};
use mirador_core::analysis::{HeightForm, ObstacleForm, ScoreConfig};
use mirador_core::information_map::MapConfig;
use mirador_core::surface::SurfaceConfig;

/// A named change of the defaults.
type Change = (&'static str, fn(&mut Trial));

/// What is tried on all scenes together.
const CHANGES: [Change; 14] = [
    ("defaults", |_| ()),
    ("filter of 5 cm", |t| t.surface = SurfaceConfig { filter_radius_m: 0.05, ..t.surface.clone() }),
    ("u_B = 0.7", |t| t.map = MapConfig { obstacle_threshold: 0.7, ..t.map }),
    ("another seed", |t| t.seed = 2),
    ("H = exp(-x^2/2)", |t| t.scores.height_form = HeightForm::Gentle),
    ("H = exp(-|x|), literal", |t| t.scores.height_form = HeightForm::Literal),
    ("B literal", |t| t.scores.obstacle_form = ObstacleForm::Literal),
    ("no noise filter", |t| t.surface = SurfaceConfig { filter_radius_m: 0.0, ..t.surface.clone() }),
    ("obstacles weigh 1", |t| t.map = MapConfig { obstacle_weight: 1.0, ..t.map }),
    ("two scans", |t| t.scans = 2),
    ("vertical off by 1 deg", |t| t.tilt_deg = 1.0),
    ("vertical off by 2 deg", |t| t.tilt_deg = 2.0),
    ("half of the edge returns mixed", |t| t.mixed_pixels = 0.5),
    ("height of the scanner known", |t| {
        t.scores = ScoreConfig { scanner_height_m: Some(1.0), ..t.scores.clone() };
    }),
];

fn main() -> Result<(), Box<dyn Error>> {
    let only = std::env::args().nth(1);
    for theta_deg in [15.0, 30.0] {
        println!("\ntheta = {theta_deg} deg\n\n{HEAD}");
        for scene in SCENES.into_iter().chain(["branches", "grass"]) {
            println!("{}", judge(scene, &Trial::new(theta_deg))?.row(scene));
        }
        for (name, change) in CHANGES.into_iter().filter(|(name, _)| only.as_ref().is_none_or(|o| name.contains(o))) {
            let mut trial = Trial::new(theta_deg);
            change(&mut trial);
            let mut all = Judgement::default();
            for scene in SCENES {
                all.add(&judge(scene, &trial)?);
            }
            println!("{}", all.row(&format!("all six: {name}")));
            eprintln!("{name}: {}", all.objects());
        }
    }
    Ok(())
}
