//! Files that other programs wrote (`fixtures/generate.py`), and damaged ones.

use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use crate::simulation::scene::Colour;

const FILES: [&str; 10] = [
    "trimesh.ply",
    "trimesh_text.ply",
    "assimp.ply",
    "trimesh.off",
    "trimesh.obj",
    "assimp.obj",
    "trimesh.dae",
    "assimp.dae",
    "assimp.3ds",
    "assimp.mtl",
];

fn path(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/src/simulation/model/fixtures")).join(name)
}

/// Right only when the surface is closed and its triangles face outward.
fn volume(mesh: &Mesh) -> f64 {
    let at = |index: u32| nalgebra::Vector3::from(mesh.vertices()[index as usize]);
    mesh.triangles().iter().map(|&[a, b, c]| at(a).dot(&at(b).cross(&at(c))) / 6.0).sum()
}

fn message(name: &str, bytes: &[u8]) -> String {
    Mesh::from_bytes(bytes, name, &|_| None).unwrap_err().to_string()
}

#[test]
fn files_of_other_programs_have_the_volume_and_the_size_they_were_given() {
    for name in FILES.into_iter().filter(|name| !name.ends_with("mtl")) {
        let mesh = Mesh::load(&path(name)).unwrap();
        assert!((volume(&mesh) - 4.0).abs() < 1e-5, "{name}: {}", volume(&mesh));
        let [low, high] = mesh.bounds();
        // Both say that y is up in the COLLADA they write, whatever they were given.
        let size = if name.ends_with("dae") { [2.0, 3.0, 1.0] } else { [2.0, 1.0, 3.0] };
        for axis in 0..3 {
            assert!((high[axis] - low[axis] - size[axis]).abs() < 1e-6, "{name}: {low:?} {high:?}");
        }
    }
}

#[test]
fn colours_come_from_faces_and_materials() {
    for name in ["trimesh.ply", "assimp.obj", "assimp.dae", "assimp.3ds"] {
        let mesh = Mesh::load(&path(name)).unwrap();
        let colour = (0..mesh.triangles().len()).map(|face| mesh.colour(face)).collect::<Vec<_>>();
        assert!(colour.iter().all(|c| *c == Some(Colour([200, 100, 50]))), "{name}: {:?}", colour[0]);
    }
    assert_eq!(Mesh::load(&path("trimesh.off")).unwrap().colour(0), None);
}

#[test]
fn the_reader_of_a_wrong_file_is_told_where() {
    assert_eq!(
        message("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 zero\n"),
        "a.off, line 4: `zero` should be a coordinate; a vertex has three numbers"
    );
    assert!(
        message("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
            .starts_with("a.off, line 6: a face asks for vertex 7")
    );
    assert!(message("a.off", b"OFF\n9999999999 1 0\n").contains("line 2: 9999999999 vertices; at most"));
    assert!(message("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 x\nf 1 2 3\n").starts_with("a.obj, line 3: "));
    assert!(message("a.3ds", b"MM\x06\x00\x00\x01").contains("byte 0"));
    assert!(message("a.3ds", b"RIFF....").contains("byte 0"));
    assert!(message("a.dae", b"<COLLADA>\n<a>\n</b></COLLADA>").contains("line 3"));
    let missing = b"<COLLADA><library_visual_scenes><visual_scene>\n<node>\n<instance_geometry url=\"#x\"/></node></visual_scene></library_visual_scenes></COLLADA>";
    assert_eq!(message("a.dae", missing), "a.dae, line 3: <instance_geometry>: nothing in the file has the id `#x`");
    assert!(
        message("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\nx\n")
            .contains("line 6")
    );
    assert!(message("a.stl", b"solid").contains("known endings are ply, dae, off, 3ds, obj"));
    let text = Mesh::load(&path("none.ply")).unwrap_err().to_string();
    assert!(text.contains("none.ply: cannot read the mesh"), "{text}");
}

#[test]
fn faces_without_area_and_coordinates_that_are_no_numbers_are_refused() {
    let checked = |text: &str| Mesh::from_bytes(text.as_bytes(), "a.off", &|_| None).unwrap().checked("a.off");
    let flat = "OFF\n4 2 0\n0 0 0\n1 0 0\n2 0 0\n0 1 0\n3 0 1 3\n3 0 1 2\n";
    let text = checked(flat).unwrap_err().to_string();
    assert_eq!(text, "a.off: 1 of its triangles have no area, the first is triangle 1 (from 0); repair the mesh");
    let mesh = Mesh::from_bytes(flat.as_bytes(), "a.off", &|_| None).unwrap().without_degenerate();
    assert_eq!(mesh.checked("a.off").unwrap().triangles(), [[0, 1, 3]]);
    let text = checked("OFF\n3 1 0\n0 0 0\n1 0 NaN\n0 1 0\n3 0 1 2\n").unwrap_err().to_string();
    assert!(text.contains("vertex 1 (from 0) has a coordinate that is not finite"), "{text}");
    assert!(checked("OFF\n0 0 0\n").unwrap_err().to_string().contains("has no faces"));
}

#[test]
fn nodes_that_stand_for_one_another_do_not_take_forever() {
    let node = |k: u32| {
        format!("<node id=\"n{k}\"><instance_node url=\"#n{0}\"/><instance_node url=\"#n{0}\"/></node>", k + 1)
    };
    let nodes: String = (0..60).map(node).collect();
    let text = format!(
        "<COLLADA><library_visual_scenes><visual_scene>{nodes}<node id=\"n60\"/></visual_scene></library_visual_scenes></COLLADA>"
    );
    assert!(message("a.dae", text.as_bytes()).contains("more than 100000"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]
    #[test]
    fn a_damaged_file_is_an_error_or_a_sound_mesh(
        file in 0..FILES.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = std::fs::read(path(FILES[file])).unwrap();
        for (at, with) in changes {
            let at = at.index(bytes.len());
            bytes[at] = with;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        // A material file is damaged under a sound mesh.
        let (name, mesh) = if FILES[file].ends_with("mtl") {
            let mesh = std::fs::read(path("assimp.obj")).unwrap();
            ("assimp.obj", Mesh::from_bytes(&mesh, "assimp.obj", &|_| Some(bytes.clone())))
        } else {
            let beside = |name: &str| std::fs::read(path(name)).ok();
            (FILES[file], Mesh::from_bytes(&bytes, FILES[file], &beside))
        };
        match mesh {
            Ok(mesh) => {
                let count = mesh.vertices().len();
                prop_assert!(mesh.triangles().iter().flatten().all(|&corner| (corner as usize) < count), "{}", name);
            }
            Err(error) => prop_assert!(error.to_string().starts_with(name), "{}", error),
        }
    }
}
