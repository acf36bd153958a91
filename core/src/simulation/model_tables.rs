//! The tables of a world file that place meshes.

use std::collections::HashMap;
use std::sync::Arc;

use serde::Deserialize;
use toml::Spanned;

use super::assets::Assets;
use super::file_values::{Factor, Number};
use super::scene::{Colour, Label, ModelPlacement, Placement, WorkArea};
use super::scene_file::Fault;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModelTable {
    file: Spanned<String>,
    label: Label,
    x_m: Number,
    y_m: Number,
    /// Of the file's origin; on the ground unless given.
    z_m: Option<Number>,
    /// Roll, pitch, yaw.
    #[serde(default)]
    rotation_rad: [Number; 3],
    scale: Option<Scale>,
    colour: Option<Colour>,
    #[serde(default)]
    drop_degenerate: bool,
}

/// One factor, or one an axis.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
enum Scale {
    All(Factor),
    Axes([Factor; 3]),
}

/// Reads and places all models; each file is read once.
pub(super) fn models(
    tables: Vec<Spanned<ModelTable>>,
    ground: &WorkArea,
    assets: &Assets,
) -> Result<Vec<ModelPlacement>, Fault> {
    let mut read = HashMap::new();
    let mut models = Vec::with_capacity(tables.len());
    for table in tables {
        let offset = table.span().start;
        let table = table.into_inner();
        let (x, y) = (table.x_m.0, table.y_m.0);
        if !ground.contains(x, y) {
            let message = format!(
                "a model at x = {x}, y = {y} stands beyond the ground, which ends at x = {:?}, y = {:?}",
                ground.x_m, ground.y_m
            );
            return Err(Fault { offset, message });
        }
        let file = table.file.get_ref().clone();
        let key = (file.clone(), table.drop_degenerate);
        let mesh = match read.get(&key) {
            Some(mesh) => Arc::clone(mesh),
            None => {
                let mesh = assets
                    .mesh(&file, table.drop_degenerate)
                    .map_err(|error| Fault { offset: table.file.span().start, message: format!("file: {error}") })?;
                let mesh = Arc::new(mesh);
                read.insert(key, Arc::clone(&mesh));
                mesh
            }
        };
        models.push(ModelPlacement {
            file,
            label: table.label,
            mesh,
            position: [x, y],
            placement: table.z_m.map_or(Placement::OnGround { above: 0.0 }, |z| Placement::At { z: z.0 }),
            rotation: table.rotation_rad.map(|angle| angle.0),
            scale: match table.scale {
                None => [1.0; 3],
                Some(Scale::All(factor)) => [factor.0; 3],
                Some(Scale::Axes(factors)) => factors.map(|factor| factor.0),
            },
            colour: table.colour,
        });
    }
    Ok(models)
}
