//! The tables of a scene file that place solids, one a kind.

use nalgebra::Vector3;
use serde::Deserialize;

use super::file_values::{Length, Number, Steps};
use super::scene::{Colour, Label, Placement, SceneObject};
use super::shapes::Shape;

/// Of a trunk.
const BARK: Colour = Colour([96, 76, 56]);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BoxTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    height_m: Length,
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RoundTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    radius_m: Length,
    height_m: Length,
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(transparent)]
pub(super) struct CylinderTable(RoundTable);

#[derive(Deserialize)]
#[serde(transparent)]
pub(super) struct ConeTable(RoundTable);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    radius_m: Length,
    colour: Option<Colour>,
}

/// The form of a tree's crown.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Crown {
    /// A broad-leaved tree: the trunk ends in the middle of the crown.
    #[default]
    Sphere,
    /// A conifer: the trunk ends at the crown's base.
    Cone,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TreeTable {
    x_m: Number,
    y_m: Number,
    trunk_radius_m: Length,
    trunk_height_m: Length,
    crown_radius_m: Length,
    #[serde(default)]
    crown: Crown,
    /// Of a cone only; twice the radius unless given.
    crown_height_m: Option<Length>,
    /// Of the crown.
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HouseTable {
    x_m: Number,
    y_m: Number,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    wall_height_m: Length,
    roof_height_m: Length,
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WallTable {
    from_m: [Number; 2],
    to_m: [Number; 2],
    height_m: Length,
    thickness_m: Length,
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RampTable {
    x_m: Number,
    y_m: Number,
    /// Of its foot.
    z_m: Option<Number>,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    height_m: Length,
    colour: Option<Colour>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StairsTable {
    /// Middle of the first riser.
    x_m: Number,
    y_m: Number,
    /// Upwards.
    #[serde(default)]
    yaw_deg: Number,
    width_m: Length,
    tread_m: Length,
    riser_m: Length,
    steps: Steps,
    colour: Option<Colour>,
}

/// What a table places in the scene.
pub(super) trait Place {
    /// The objects, in the order in which they are built.
    fn place(&self, objects: &mut Vec<SceneObject>);
}

fn placement(z: Option<Number>) -> Placement {
    z.map_or(Placement::OnGround { above: 0.0 }, |z| Placement::At { z: z.0 })
}

impl Place for BoxTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let size = Vector3::new(self.length_m.0, self.width_m.0, self.height_m.0);
        objects.push(SceneObject {
            label: self.label,
            shape: Shape::Box { size },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(self.z_m),
            colour: self.colour,
        });
    }
}

impl RoundTable {
    fn object(&self, shape: Shape) -> SceneObject {
        let (x, y) = (self.x_m.0, self.y_m.0);
        let placement = placement(self.z_m);
        SceneObject { label: self.label, shape, x, y, yaw: 0.0, placement, colour: self.colour }
    }
}

impl Place for CylinderTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (radius, height) = (self.0.radius_m.0, self.0.height_m.0);
        objects.push(self.0.object(Shape::Cylinder { radius, height }));
    }
}

impl Place for ConeTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (radius, height) = (self.0.radius_m.0, self.0.height_m.0);
        objects.push(self.0.object(Shape::Cone { radius, height }));
    }
}

impl Place for SphereTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let shape = Shape::Sphere { radius: self.radius_m.0 };
        let (x, y, placement) = (self.x_m.0, self.y_m.0, placement(self.z_m));
        objects.push(SceneObject { label: self.label, shape, x, y, yaw: 0.0, placement, colour: self.colour });
    }
}

impl Place for TreeTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (trunk, radius) = (self.trunk_height_m.0, self.crown_radius_m.0);
        let (x, y) = (self.x_m.0, self.y_m.0);
        let mut put = |shape, above, colour| {
            let placement = Placement::OnGround { above };
            objects.push(SceneObject { label: Label::Tree, shape, x, y, yaw: 0.0, placement, colour });
        };
        put(Shape::Cylinder { radius: self.trunk_radius_m.0, height: trunk }, 0.0, Some(BARK));
        match self.crown {
            Crown::Sphere => put(Shape::Sphere { radius }, trunk - radius, self.colour),
            Crown::Cone => {
                let height = self.crown_height_m.map_or(2.0 * radius, |h| h.0);
                put(Shape::Cone { radius, height }, trunk, self.colour);
            }
        }
    }
}

impl Place for HouseTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        objects.push(SceneObject {
            label: Label::Building,
            shape: Shape::House {
                length: self.length_m.0,
                width: self.width_m.0,
                wall_height: self.wall_height_m.0,
                roof_height: self.roof_height_m.0,
            },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(None),
            colour: self.colour,
        });
    }
}

impl Place for WallTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let ([x0, y0], [x1, y1]) = (self.from_m.map(|n| n.0), self.to_m.map(|n| n.0));
        objects.push(SceneObject {
            label: Label::Wall,
            shape: Shape::Box { size: Vector3::new((x1 - x0).hypot(y1 - y0), self.thickness_m.0, self.height_m.0) },
            x: (x0 + x1) / 2.0,
            y: (y0 + y1) / 2.0,
            yaw: (y1 - y0).atan2(x1 - x0),
            placement: placement(None),
            colour: self.colour,
        });
    }
}

impl Place for RampTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        objects.push(SceneObject {
            label: Label::Ramp,
            shape: Shape::Ramp { length: self.length_m.0, width: self.width_m.0, height: self.height_m.0 },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(self.z_m),
            colour: self.colour,
        });
    }
}

impl Place for StairsTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let yaw = self.yaw_deg.0.to_radians();
        for step in 0..self.steps.0 {
            // Each step is a block from its riser to the end of its tread.
            let ahead = (f64::from(step) + 0.5) * self.tread_m.0;
            let size = Vector3::new(self.tread_m.0, self.width_m.0, f64::from(step + 1) * self.riser_m.0);
            objects.push(SceneObject {
                label: Label::Stairs,
                shape: Shape::Box { size },
                x: self.x_m.0 + ahead * yaw.cos(),
                y: self.y_m.0 + ahead * yaw.sin(),
                yaw,
                placement: placement(None),
                colour: self.colour,
            });
        }
    }
}
