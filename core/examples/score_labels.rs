//! How well the scores tell ground from obstacles, on labelled scans: six on which the constants of the steps were chosen, and
//! three that were put aside.
//!
//!     cargo run --release -p mirador-core --example score_labels -- [part of a trial's name]
//!
//! Prints one line a scene and trial: precision and recall of navigable and of obstacle cells within 15 m.

use std::error::Error;

#[path = "../tests/labelled/mod.rs"]
#[allow(dead_code)]
mod labelled;

use labelled::{APART, FRESH, HEAD, Judgement, Recording, SCENES, Trial};
use mirador_core::analysis::{HeightForm, ObstacleForm, ScoreConfig};
use mirador_core::information_map::MapConfig;
use mirador_core::surface::SurfaceConfig;

/// A named change of the defaults.
type Change = (&'static str, fn(&mut Trial));

/// What is tried on all scenes together.
const CHANGES: [Change; 15] = [
    ("defaults", |_| ()),
    ("B without steps", |t| t.scores.obstacle_form = ObstacleForm::Calibrated),
    ("B literal", |t| t.scores.obstacle_form = ObstacleForm::Literal),
    ("u_B = 0.75", |t| t.map = MapConfig { obstacle_threshold: 0.75, ..t.map }),
    ("obstacles weigh 1", |t| t.map = MapConfig { obstacle_weight: 1.0, ..t.map }),
    ("H = exp(-x^2/2)", |t| t.scores.height_form = HeightForm::Gentle),
    ("H literal, exp of minus x", |t| t.scores.height_form = HeightForm::Literal),
    ("filter of 5 cm", |t| t.surface = SurfaceConfig { filter_radius_m: 0.05, ..t.surface.clone() }),
    ("no noise filter", |t| t.surface = SurfaceConfig { filter_radius_m: 0.0, ..t.surface.clone() }),
    ("another seed", |t| t.seed = 2),
    ("two scans", |t| t.scans = 2),
    ("vertical off by 1 deg", |t| t.tilt_deg = 1.0),
    ("vertical off by 2 deg", |t| t.tilt_deg = 2.0),
    ("half of the edge returns mixed", |t| t.mixed_pixels = 0.5),
    ("height of the scanner known", |t| {
        t.scores = ScoreConfig { scanner_height_m: Some(1.0), ..t.scores.clone() };
    }),
];

/// The scans of some scenes.
fn record<'a>(scenes: &[&'a str], seed: u64) -> Result<Vec<(&'a str, Recording)>, Box<dyn Error>> {
    scenes.iter().map(|scene| Ok((*scene, Recording::new(scene, 2, seed)?))).collect()
}

/// Judges some scenes, prints each if wanted, and takes them together.
fn judge(scenes: &[(&str, Recording)], trial: &Trial, each: bool) -> Result<Judgement, Box<dyn Error>> {
    let mut all = Judgement::default();
    for (name, recording) in scenes {
        let one = recording.judge(trial)?;
        if each {
            println!("{}", one.row(name));
        }
        all.add(&one);
    }
    Ok(all)
}

fn main() -> Result<(), Box<dyn Error>> {
    let only = std::env::args().nth(1);
    let [scenes, apart, fresh] = [&SCENES[..], &APART[..], &FRESH[..]].map(|scenes| record(scenes, 1));
    let (scenes, apart, fresh, reseeded) = (scenes?, apart?, fresh?, record(&SCENES, 2)?);
    for theta_deg in [15.0, 30.0] {
        println!("\ntheta = {theta_deg} deg\n\n{HEAD}");
        let trial = Trial::new(theta_deg);
        for (name, scenes) in [("all six", &scenes), ("all three fresh", &fresh)] {
            let all = judge(scenes, &trial, true)?;
            println!("{}", all.row(name));
            eprintln!("{name}, {theta_deg} deg: {}", all.objects());
        }
        judge(&apart, &trial, true)?;
        println!();
        for (name, change) in CHANGES.into_iter().filter(|(name, _)| only.as_ref().is_none_or(|o| name.contains(o))) {
            let mut trial = Trial::new(theta_deg);
            change(&mut trial);
            let all = judge(if trial.seed == 1 { &scenes } else { &reseeded }, &trial, false)?;
            let fresh = judge(&fresh, &trial, false)?;
            println!("{} {}", all.brief(name), fresh.brief(""));
            eprintln!("{name}: {}", all.objects());
        }
    }
    Ok(())
}
