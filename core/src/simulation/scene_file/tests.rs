//! What a scene file may say, and what it is told when it is wrong.

use super::*;
use crate::simulation::{CompiledScene, SensorKind, Shape};
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

/// The example in the documentation.
fn documented() -> String {
    let page = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/worlds.md"));
    page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap().to_owned()
}

#[test]
fn the_example_in_the_documentation_is_a_world() {
    let worlds = concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/example.toml");
    let scene = parse(&documented(), "example.toml", &Assets::beside(worlds.as_ref())).map_err(|f| f.message).unwrap();
    assert_eq!((scene.objects.len(), scene.models.len(), scene.robots.len()), (1, 1, 1));
    let robot = &scene.robots[0];
    assert_eq!((robot.wheels.len(), robot.sensors.len(), robot.boxes.len()), (3, 4, 1));
    let SensorKind::Laser3d(scanner) = &robot.sensors[0].kind else { panic!("{:?}", robot.sensors[0]) };
    assert_eq!(**scanner, crate::simulation::ScannerConfig::lms111());
    assert!(CompiledScene::new(scene).is_ok());
}

#[test]
fn a_wrong_model_is_reported_with_line_and_reason() {
    let model = |rest: &str| message(&format!("[[model]]\nlabel = \"other\"\nx_m = 1\ny_m = 1\n{rest}"));
    let text = model("file = \"no.obj\"\n");
    assert!(text.starts_with("a.toml, line 12: file: no.obj: cannot read the mesh"), "{text}");
    let text = model("file = \"a.obj\"\nscale = 0\n");
    assert!(text.contains("line 13"), "{text}");
    let text = model("file = \"a.obj\"\ncolour = [1, 2, 300]\n");
    assert!(text.contains("line 13") && text.contains("300"), "{text}");
}

#[test]
fn heights_come_from_a_file_and_cover_the_area() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("h.txt"), "0 0 0\n1 1 1\n0 0 2\n").unwrap();
    let load = |tail: &str| {
        let path = folder.path().join("w.toml");
        std::fs::write(&path, format!("{HEAD}{tail}")).unwrap();
        Scene::load(&path)
    };
    let heights =
        |cell: f64| format!("[terrain]\nheights = {{ file = \"h.txt\", cell_m = {cell}, x_m = -6, y_m = -6 }}\n");
    let scene = CompiledScene::new(load(&heights(6.0)).unwrap()).unwrap();
    assert_eq!(scene.ground_height(6.0, -6.0), Some(2.0));
    assert_eq!(scene.ground_height(0.0, 0.0), Some(1.0));
    assert_eq!(scene.ground_height(-6.0, 6.0), Some(0.0));
    let text = load(&heights(4.0)).unwrap_err().to_string();
    assert!(text.contains("line 8") && text.contains("terrain.heights must cover the work area"), "{text}");
    let text = load("[terrain]\nheights = { file = \"none.png\", cell_m = 1, x_m = 0, y_m = 0 }\n").unwrap_err();
    assert!(text.to_string().contains("terrain.heights: none.png: cannot be read"), "{text}");
}

#[test]
fn two_sensors_or_robots_of_one_name_are_refused() {
    let sensor = |name: &str, rest: &str| format!("[[robot.sensor]]\nname = \"{name}\"\nmount_m = [0, 0, 1]\n{rest}");
    let laser = "kind = \"laser1d\"\nrange_m = 5\n";
    let text = message(&format!("[[robot]]\nname = \"r\"\n{}{}", sensor("a", laser), sensor("a", laser)));
    assert!(text.starts_with("a.toml, line 16: two sensors are called `a`"), "{text}");
    let text = message("[[robot]]\nname = \"r\"\n[[robot]]\nname = \"r\"\n");
    assert!(text.starts_with("a.toml, line 11: two robots are called `r`"), "{text}");
}

#[test]
fn a_sensor_takes_the_keys_of_its_kind_and_no_others() {
    let text = |rest: &str| {
        message(&format!("[[robot]]\nname = \"r\"\n[[robot.sensor]]\nname = \"a\"\nmount_m = [0, 0, 1]\n{rest}"))
    };
    let error = text("kind = \"camera\"\nwidth = 10\nheight = 10\n");
    assert!(error.contains("line 10") && error.contains("a camera needs the key `field_of_view_deg`"), "{error}");
    let error = text("kind = \"laser1d\"\nrange_m = 5\nwidth = 10\n");
    assert!(error.contains("a laser1d has no key `width`; it knows range_m, noise_m"), "{error}");
    let error = text("kind = \"sonar\"\n");
    assert!(error.contains("`sonar`") && error.contains("laser3d"), "{error}");
    let turning = "kind = \"laser3d\"\nrange_m = 5\nresolution_deg = 1\nfield_of_view_deg = 270\n";
    let error = text(&format!("{turning}turn_deg = [90, -90]\n"));
    assert!(error.contains("turn_deg = [90, -90] must rise"), "{error}");
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(tail in "[\\[\\]a-z_=\"0-9\n. -]{0,80}") {
        let _ = Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml");
        let _ = Scene::from_toml(&tail, "a.toml");
    }
}
