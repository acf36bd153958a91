//! What a scene file may say, and what it is told when it is wrong.

use super::*;
use crate::simulation::Shape;
use proptest::prelude::*;

const HEAD: &str = "name = \"t\"\n[area]\nx_m = [-5, 5]\ny_m = [-5, 5]\n[start]\nx_m = 0\ny_m = 0\n";

fn message(tail: &str) -> String {
    Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml").unwrap_err().to_string()
}

#[test]
fn the_smallest_scene_is_flat_and_empty() {
    let scene = Scene::from_toml(HEAD, "a.toml").unwrap();
    assert!(scene.objects.is_empty() && scene.poses.is_empty());
    assert_eq!(scene.terrain, TerrainConfig::default());
}

#[test]
fn an_unknown_key_is_reported_with_its_line_and_the_known_keys() {
    let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\ny_m = 1\nradios_m = 2\n");
    assert!(text.starts_with("a.toml, line 12: unknown field `radios_m`"), "{text}");
    assert!(text.contains("`radius_m`"), "{text}");
}

#[test]
fn an_unknown_kind_of_object_is_answered_with_the_known_kinds() {
    let text = message("[[pyramid]]\nx_m = 1\n");
    assert!(text.contains("line 8") && text.contains("`pyramid`") && text.contains("`house`"), "{text}");
}

#[test]
fn an_unknown_label_is_answered_with_the_known_labels() {
    let text = message("[[sphere]]\nlabel = \"dragon\"\nx_m = 1\ny_m = 1\nradius_m = 2\n");
    assert!(text.contains("line 9") && text.contains("`dragon`") && text.contains("`vehicle`"), "{text}");
}

#[test]
fn a_value_out_of_range_is_reported_with_line_key_and_range() {
    let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\ny_m = 1\nradius_m = -2\n");
    assert!(text.starts_with("a.toml, line 12: -2 is out of range, allowed are 0.001 to 10000"), "{text}");
    assert!(text.contains("radius_m = -2"), "{text}");
    let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = nan\ny_m = 1\nradius_m = 2\n");
    assert!(text.contains("line 10") && text.contains("x_m = nan"), "{text}");
}

#[test]
fn a_missing_key_is_named() {
    let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\nradius_m = 2\n");
    assert!(text.contains("line 8") && text.contains("`y_m`"), "{text}");
}

#[test]
fn a_terrain_value_out_of_range_is_named() {
    let text = message("[terrain]\ncell_m = -1\n");
    assert!(text.contains("line 8") && text.contains("terrain.cell_m must be above 0"), "{text}");
}

#[test]
fn a_pose_outside_the_area_and_an_object_beyond_the_ground_are_refused() {
    let text = message("[[poses]]\nx_m = 1\ny_m = 1\n[[poses]]\nx_m = 7\ny_m = 1\n");
    assert!(text.contains("line 11") && text.contains("x_m = 7"), "{text}");
    let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 70\ny_m = 1\nradius_m = 2\n");
    assert!(text.contains("line 8") && text.contains("beyond the ground"), "{text}");
}

#[test]
fn stairs_climb_along_their_heading() {
    let tail = "[[stairs]]\nx_m = 1\ny_m = 0\nyaw_deg = 90\nwidth_m = 2\ntread_m = 0.3\nriser_m = 0.16\nsteps = 3\n";
    let scene = Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml").unwrap();
    assert_eq!(scene.objects.len(), 3);
    let last = scene.objects[2];
    assert!((last.x - 1.0).abs() < 1e-12 && (last.y - 0.75).abs() < 1e-12);
    assert!(matches!(last.shape, Shape::Box { size } if (size.z - 0.48).abs() < 1e-12));
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(tail in "[\\[\\]a-z_=\"0-9\n. -]{0,80}") {
        let _ = Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml");
        let _ = Scene::from_toml(&tail, "a.toml");
    }
}
