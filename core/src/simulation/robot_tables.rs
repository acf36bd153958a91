//! The tables of a world file that describe robots.

use std::collections::HashSet;
use std::sync::Arc;

use serde::Deserialize;
use toml::Spanned;

use super::assets::Assets;
use super::file_values::{Length, Number};
use super::robot::{BodyBox, Robot, Sensor, SensorKind, Wheel, WheelKind};
use super::scanner_config::ScannerConfig;
use super::scene::ScanPose;
use super::scene_file::Fault;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotTable {
    name: Spanned<String>,
    /// The world's start unless given.
    x_m: Option<Number>,
    y_m: Option<Number>,
    yaw_deg: Option<Number>,
    #[serde(default, rename = "box")]
    boxes: Vec<BoxTable>,
    mesh: Option<Spanned<String>>,
    mass_kg: Option<Length>,
    mass_height_m: Option<Length>,
    max_speed_m_s: Option<Length>,
    #[serde(default, rename = "wheel")]
    wheels: Vec<WheelTable>,
    #[serde(default, rename = "sensor")]
    sensors: Vec<Spanned<SensorTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoxTable {
    size_m: [Length; 3],
    centre_m: [Number; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WheelTable {
    kind: KindOfWheel,
    radius_m: Length,
    width_m: Length,
    mount_m: [Number; 3],
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum KindOfWheel {
    Free,
    Caster,
    Driven,
    Steered,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum KindOfSensor {
    Camera,
    Laser1d,
    Laser2d,
    Laser3d,
}

/// The keys of all kinds: a kind takes those it needs, and refuses the rest.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorTable {
    name: Spanned<String>,
    kind: KindOfSensor,
    mount_m: [Number; 3],
    #[serde(default)]
    rotation_rad: [Number; 3],
    width: Option<Pixels>,
    height: Option<Pixels>,
    range_m: Option<Length>,
    noise_m: Option<Noise>,
    resolution_deg: Option<Angle>,
    field_of_view_deg: Option<Angle>,
    turn_deg: Option<[Number; 2]>,
    turn_step_deg: Option<Angle>,
    dark_range_m: Option<Noise>,
    divergence_deg: Option<Noise>,
}

/// Pixels along a side of an image.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "u32")]
struct Pixels(usize);

impl TryFrom<u32> for Pixels {
    type Error = String;

    fn try_from(value: u32) -> Result<Self, String> {
        if (1..=8192).contains(&value) {
            Ok(Self(value as usize))
        } else {
            Err(format!("{value} pixels, allowed are 1 to 8192"))
        }
    }
}

/// An angle above 0 [deg].
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Angle(f64);

impl TryFrom<f64> for Angle {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        let fits = (0.01..=360.0).contains(&value);
        if fits { Ok(Self(value)) } else { Err(format!("{value} deg is out of range, allowed are 0.01 to 360")) }
    }
}

/// A number of 0 or more.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(try_from = "f64")]
struct Noise(f64);

impl TryFrom<f64> for Noise {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        let fits = (0.0..=100.0).contains(&value);
        if fits { Ok(Self(value)) } else { Err(format!("{value} is out of range, allowed are 0 to 100")) }
    }
}

fn fault(offset: usize, message: impl Into<String>) -> Fault {
    Fault { offset, message: message.into() }
}

/// The robots of a world file. `line` gives the line of a byte of its text.
pub(super) fn robots(
    tables: Vec<Spanned<RobotTable>>,
    start: &ScanPose,
    assets: &Assets,
    line: impl Fn(usize) -> usize,
) -> Result<Vec<Robot>, Fault> {
    let mut names = HashSet::new();
    let mut robots = Vec::new();
    for table in tables {
        let offset = table.span().start;
        let table = table.into_inner();
        let name_offset = table.name.span().start;
        if !names.insert(table.name.get_ref().clone()) {
            return Err(fault(
                name_offset,
                format!("two robots are called `{}`; names are unique", table.name.get_ref()),
            ));
        }
        robots.push(table.robot(start, assets, line(offset))?);
    }
    Ok(robots)
}

impl RobotTable {
    fn robot(self, start: &ScanPose, assets: &Assets, line: usize) -> Result<Robot, Fault> {
        let usual = Robot::default();
        let mesh = match self.mesh {
            None => None,
            Some(file) => {
                let mesh = assets.mesh(file.get_ref(), true);
                Some(Arc::new(mesh.map_err(|error| fault(file.span().start, format!("mesh: {error}")))?))
            }
        };
        let boxes: Vec<_> = self
            .boxes
            .iter()
            .map(|b| BodyBox { size: b.size_m.map(|v| v.0), centre: b.centre_m.map(|v| v.0) })
            .collect();
        let own_body = mesh.is_some() || !boxes.is_empty();
        let wheels: Vec<_> = self.wheels.iter().map(WheelTable::wheel).collect();
        let start = ScanPose {
            x: self.x_m.map_or(start.x, |v| v.0),
            y: self.y_m.map_or(start.y, |v| v.0),
            yaw: self.yaw_deg.map_or(start.yaw, |v| v.0.to_radians()),
        };
        let sensors = if self.sensors.is_empty() { usual.sensors } else { sensors(self.sensors)? };
        Ok(Robot {
            name: self.name.into_inner(),
            start,
            boxes: if own_body { boxes } else { usual.boxes },
            mesh,
            mass: self.mass_kg.map_or(usual.mass, |v| v.0),
            mass_height: self.mass_height_m.map_or(usual.mass_height, |v| v.0),
            wheels: if wheels.is_empty() { usual.wheels } else { wheels },
            sensors,
            max_speed: self.max_speed_m_s.map_or(usual.max_speed, |v| v.0),
            line,
        })
    }
}

impl WheelTable {
    fn wheel(&self) -> Wheel {
        let kind = match self.kind {
            KindOfWheel::Free => WheelKind::Free,
            KindOfWheel::Caster => WheelKind::Caster,
            KindOfWheel::Driven => WheelKind::Driven,
            KindOfWheel::Steered => WheelKind::Steered,
        };
        Wheel { kind, radius: self.radius_m.0, width: self.width_m.0, mount: self.mount_m.map(|v| v.0) }
    }
}

fn sensors(tables: Vec<Spanned<SensorTable>>) -> Result<Vec<Sensor>, Fault> {
    let mut names = HashSet::new();
    let mut sensors = Vec::new();
    for table in tables {
        let offset = table.span().start;
        let table = table.into_inner();
        if !names.insert(table.name.get_ref().clone()) {
            let message = format!("two sensors are called `{}`; names are unique on a robot", table.name.get_ref());
            return Err(fault(table.name.span().start, message));
        }
        let kind = table.kind().map_err(|message| fault(offset, message))?;
        sensors.push(Sensor {
            name: table.name.into_inner(),
            position: table.mount_m.map(|v| v.0),
            rotation: table.rotation_rad.map(|v| v.0),
            kind,
        });
    }
    Ok(sensors)
}

impl SensorTable {
    fn kind(&self) -> Result<SensorKind, String> {
        let (name, known): (_, &[&str]) = match self.kind {
            KindOfSensor::Camera => ("camera", &["width", "height", "field_of_view_deg"]),
            KindOfSensor::Laser1d => ("laser1d", &["range_m", "noise_m"]),
            KindOfSensor::Laser2d => ("laser2d", &["range_m", "noise_m", "resolution_deg", "field_of_view_deg"]),
            KindOfSensor::Laser3d => ("laser3d", &LASER_3D_KEYS),
        };
        if let Some((_, key)) = self.given().into_iter().find(|(given, key)| *given && !known.contains(key)) {
            return Err(format!("a {name} has no key `{key}`; it knows {}", known.join(", ")));
        }
        let missing = |key: &str| format!("a {name} needs the key `{key}`");
        let range = self.range_m.map(|range| range.0).ok_or_else(|| missing("range_m"));
        let noise = self.noise_m.map_or(0.01, |noise| noise.0);
        let view = self.field_of_view_deg.map(|angle| angle.0).ok_or_else(|| missing("field_of_view_deg"));
        let resolution = self.resolution_deg.map(|angle| angle.0).ok_or_else(|| missing("resolution_deg"));
        Ok(match self.kind {
            KindOfSensor::Camera => {
                let width = self.width.ok_or_else(|| missing("width"))?.0;
                let height = self.height.ok_or_else(|| missing("height"))?.0;
                let view = view?;
                if view > 170.0 {
                    return Err("field_of_view_deg of a camera must be at most 170".into());
                }
                SensorKind::Camera { width, height, field_of_view: view.to_radians() }
            }
            KindOfSensor::Laser1d => SensorKind::Laser1d { range: range?, noise },
            KindOfSensor::Laser2d => SensorKind::Laser2d {
                range: range?,
                noise,
                resolution: resolution?.to_radians(),
                field_of_view: view?.to_radians(),
            },
            KindOfSensor::Laser3d => SensorKind::Laser3d(Box::new(self.turning(range?, noise, resolution?, view?)?)),
        })
    }

    /// The keys that only some kinds have, and whether they are given.
    fn given(&self) -> [(bool, &'static str); 10] {
        [
            (self.width.is_some(), "width"),
            (self.height.is_some(), "height"),
            (self.range_m.is_some(), "range_m"),
            (self.noise_m.is_some(), "noise_m"),
            (self.resolution_deg.is_some(), "resolution_deg"),
            (self.field_of_view_deg.is_some(), "field_of_view_deg"),
            (self.turn_deg.is_some(), "turn_deg"),
            (self.turn_step_deg.is_some(), "turn_step_deg"),
            (self.dark_range_m.is_some(), "dark_range_m"),
            (self.divergence_deg.is_some(), "divergence_deg"),
        ]
    }

    /// The scanner that a planar laser makes when it is turned.
    fn turning(&self, range: f64, noise: f64, resolution: f64, view: f64) -> Result<ScannerConfig, String> {
        let [first, last] = self.turn_deg.ok_or("a laser3d needs the key `turn_deg`")?.map(|angle| angle.0);
        let turn = last - first;
        if turn <= 0.0 || turn > 360.0 {
            return Err(format!("turn_deg = [{first}, {last}] must rise, by at most 360"));
        }
        let usual = ScannerConfig::lms111();
        let step = self.turn_step_deg.map_or(resolution, |angle| angle.0);
        let config = ScannerConfig {
            first_beam_deg: 90.0 - view / 2.0,
            beam_step_deg: resolution,
            beams: (view / resolution + 1e-6) as usize + 1,
            first_sweep_deg: first,
            turn_deg: turn,
            sweeps: (turn / step).round().max(1.0) as usize,
            range_max_m: range,
            noise_m: noise,
            dark_range_m: self.dark_range_m.map_or(usual.dark_range_m, |range| range.0),
            divergence_deg: self.divergence_deg.map_or(usual.divergence_deg, |angle| angle.0),
            ..usual
        };
        config.validate().map_err(|error| error.to_string())?;
        Ok(config)
    }
}

/// The keys of a `laser3d`.
const LASER_3D_KEYS: [&str; 8] = [
    "range_m",
    "noise_m",
    "resolution_deg",
    "field_of_view_deg",
    "turn_deg",
    "turn_step_deg",
    "dark_range_m",
    "divergence_deg",
];
