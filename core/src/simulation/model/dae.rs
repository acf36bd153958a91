//! COLLADA: the geometry of a scene with its nodes' transformations and the diffuse colour of its materials.
//!
//! The XML is read by `roxmltree`, which knows the line of every element; what the elements mean is short enough to say
//! here. (The crates that know COLLADA name no line, and rest on XML readers that are no longer kept.)

use std::cell::Cell;
use std::collections::HashMap;

use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::{Document, Node};

use super::error::{Fault, Place};
use super::mesh::Mesh;
use crate::simulation::scene::Colour;

/// How deep nodes may be nested.
const DEEPEST: usize = 64;
/// How many nodes a scene may show; nodes may stand for others, so that a small file could ask for very many.
const MOST_NODES: usize = 100_000;

/// Reads every geometry that the scene shows, in metres and with z up.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Fault> {
    let text = std::str::from_utf8(bytes).map_err(|_| Fault::new(Place::File, "not text in UTF-8"))?;
    let document = Document::parse(text)
        .map_err(|error| Fault::new(Place::Line(error.pos().row as usize), format!("not well-formed XML: {error}")))?;
    let root = document.root_element();
    if root.tag_name().name() != "COLLADA" {
        return Err(Fault::new(Place::Line(1), format!("the root is <{}>, not <COLLADA>", root.tag_name().name())));
    }
    let reader = Dae::new(&document);
    let mut mesh = Mesh::default();
    let scenes: Vec<_> = root.descendants().filter(|node| node.has_tag_name_any("visual_scene")).collect();
    for scene in &scenes {
        for node in scene.children().filter(|child| child.has_tag_name_any("node")) {
            reader.add_node(node, &reader.z_up, 0, &mut mesh)?;
        }
    }
    if scenes.is_empty() {
        // Without a scene all geometries are meant, where they are.
        for geometry in root.descendants().filter(|node| node.has_tag_name_any("geometry")) {
            reader.add_geometry(geometry, &reader.z_up, &HashMap::new(), &mut mesh)?;
        }
    }
    Ok(mesh)
}

/// COLLADA files come with different namespaces; elements are known by their local name.
trait LocalName {
    fn has_tag_name_any(&self, name: &str) -> bool;
    fn child(&self, name: &str) -> Option<Self>
    where
        Self: Sized;
}

impl LocalName for Node<'_, '_> {
    fn has_tag_name_any(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }

    fn child(&self, name: &str) -> Option<Self> {
        self.children().find(|child| child.has_tag_name_any(name))
    }
}

struct Dae<'a> {
    document: &'a Document<'a>,
    ids: HashMap<&'a str, Node<'a, 'a>>,
    /// From the file's axes and unit to z up and metres.
    z_up: Matrix4<f64>,
    /// Nodes shown so far.
    shown: Cell<usize>,
}

impl<'a> Dae<'a> {
    fn new(document: &'a Document<'a>) -> Self {
        let elements = document.descendants().filter(Node::is_element);
        let ids = elements.filter_map(|node| Some((node.attribute("id")?, node))).collect();
        let asset = document.root_element().child("asset");
        let unit = asset.and_then(|asset| asset.child("unit")?.attribute("meter")?.trim().parse().ok());
        let axis = asset.and_then(|asset| asset.child("up_axis")?.text());
        let quarter = std::f64::consts::FRAC_PI_2;
        let turn = match axis.map(str::trim) {
            Some("Z_UP") => Rotation3::identity(),
            Some("X_UP") => Rotation3::from_axis_angle(&Vector3::y_axis(), -quarter),
            _ => Rotation3::from_axis_angle(&Vector3::x_axis(), quarter),
        };
        let z_up = turn.to_homogeneous() * Matrix4::new_scaling(unit.unwrap_or(1.0));
        Self { document, ids, z_up, shown: Cell::new(0) }
    }

    fn at(&self, node: Node<'a, 'a>) -> Place {
        Place::Line(self.document.text_pos_at(node.range().start).row as usize)
    }

    fn fault(&self, node: Node<'a, 'a>, reason: impl Into<String>) -> Fault {
        Fault::new(self.at(node), reason)
    }

    /// The element a `#reference` in an attribute names.
    fn referred(&self, node: Node<'a, 'a>, attribute: &str) -> Result<Node<'a, 'a>, Fault> {
        let tag = node.tag_name().name();
        let reference = node.attribute(attribute);
        let reference = reference.ok_or_else(|| self.fault(node, format!("<{tag}> without `{attribute}`")))?;
        let found = reference.strip_prefix('#').and_then(|id| self.ids.get(id)).copied();
        found.ok_or_else(|| self.fault(node, format!("<{tag}>: nothing in the file has the id `{reference}`")))
    }

    /// The numbers in an element's text.
    fn numbers<T: std::str::FromStr>(&self, node: Node<'a, 'a>) -> Result<Vec<T>, Fault> {
        let words = node.text().unwrap_or_default().split_whitespace();
        let number = |word: &str| {
            let wrong = || self.fault(node, format!("<{}>: `{word}` should be a number", node.tag_name().name()));
            word.parse().map_err(|_| wrong())
        };
        words.map(number).collect()
    }

    fn fixed<const N: usize>(&self, node: Node<'a, 'a>) -> Result<[f64; N], Fault> {
        let numbers = self.numbers(node)?;
        let count = numbers.len();
        let wrong = |_| self.fault(node, format!("<{}> has {count} numbers, not {N}", node.tag_name().name()));
        numbers.try_into().map_err(wrong)
    }

    fn add_node(&self, node: Node<'a, 'a>, parent: &Matrix4<f64>, depth: usize, mesh: &mut Mesh) -> Result<(), Fault> {
        self.shown.set(self.shown.get() + 1);
        if depth > DEEPEST || self.shown.get() > MOST_NODES {
            let reason = format!("nodes are nested more than {DEEPEST} deep, or there are more than {MOST_NODES}");
            return Err(self.fault(node, reason));
        }
        let mut placed = *parent;
        for child in node.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "matrix" => placed *= Matrix4::from_row_slice(&self.fixed::<16>(child)?),
                "translate" => placed *= Matrix4::new_translation(&Vector3::from(self.fixed::<3>(child)?)),
                "scale" => placed *= Matrix4::new_nonuniform_scaling(&Vector3::from(self.fixed::<3>(child)?)),
                "rotate" => {
                    let [x, y, z, degrees] = self.fixed::<4>(child)?;
                    let axis = Unit::try_new(Vector3::new(x, y, z), 1e-12);
                    let axis = axis.ok_or_else(|| self.fault(child, "<rotate> without an axis"))?;
                    placed *= Rotation3::from_axis_angle(&axis, degrees.to_radians()).to_homogeneous();
                }
                "instance_geometry" => {
                    let geometry = self.referred(child, "url")?;
                    self.add_geometry(geometry, &placed, &self.bound_colours(child), mesh)?;
                }
                "instance_node" => self.add_node(self.referred(child, "url")?, &placed, depth + 1, mesh)?,
                "node" => self.add_node(child, &placed, depth + 1, mesh)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// The diffuse colours of the materials bound to a geometry, by the symbol under which its faces know them.
    fn bound_colours(&self, instance: Node<'a, 'a>) -> HashMap<&'a str, Colour> {
        let bound = instance.descendants().filter(|node| node.has_tag_name_any("instance_material"));
        bound
            .filter_map(|node| {
                let effect = self.referred(node, "target").ok()?.child("instance_effect")?;
                let diffuse = self.referred(effect, "url").ok()?.descendants();
                let diffuse = diffuse.into_iter().find(|node| node.has_tag_name_any("diffuse"))?;
                let shares: Vec<f64> = self.numbers(diffuse.child("color")?).ok()?;
                let channel = |k: usize| Some((255.0 * shares.get(k)?).clamp(0.0, 255.0).round() as u8);
                Some((node.attribute("symbol")?, Colour([channel(0)?, channel(1)?, channel(2)?])))
            })
            .collect()
    }

    fn add_geometry(
        &self,
        geometry: Node<'a, 'a>,
        placed: &Matrix4<f64>,
        colours: &HashMap<&str, Colour>,
        mesh: &mut Mesh,
    ) -> Result<(), Fault> {
        let Some(body) = geometry.child("mesh") else { return Ok(()) };
        for primitive in body.children().filter(Node::is_element) {
            if matches!(primitive.tag_name().name(), "triangles" | "polylist" | "polygons") {
                let colour = primitive.attribute("material").and_then(|symbol| colours.get(symbol)).copied();
                self.add_primitive(primitive, placed, colour, mesh)?;
            }
        }
        Ok(())
    }

    fn add_primitive(
        &self,
        primitive: Node<'a, 'a>,
        placed: &Matrix4<f64>,
        colour: Option<Colour>,
        mesh: &mut Mesh,
    ) -> Result<(), Fault> {
        let at = self.at(primitive);
        let inputs: Vec<_> = primitive.children().filter(|node| node.has_tag_name_any("input")).collect();
        let offset =
            |input: &Node<'a, 'a>| input.attribute("offset").and_then(|o| o.parse::<usize>().ok()).unwrap_or(0);
        let vertex = inputs.iter().find(|input| input.attribute("semantic") == Some("VERTEX"));
        let &vertex = vertex.ok_or_else(|| Fault::new(at, "faces without an input of semantic VERTEX"))?;
        let stride = inputs.iter().map(offset).max().unwrap_or(0).saturating_add(1);
        let vertex_offset = offset(&vertex);

        let first = mesh.vertices().len() as u32;
        for position in self.positions(self.referred(vertex, "source")?)?.chunks_exact(3) {
            let position = placed.transform_point(&Point3::new(position[0], position[1], position[2]));
            mesh.add_vertex(position.coords.into());
        }
        let counts: Option<Vec<usize>> = primitive.child("vcount").map(|node| self.numbers(node)).transpose()?;
        let mirrored = placed.determinant() < 0.0;
        let mut corners = Vec::new();
        for indices in primitive.children().filter(|node| node.has_tag_name_any("p")) {
            let numbers: Vec<u32> = self.numbers(indices)?;
            let all: Vec<u32> = numbers.chunks(stride).filter_map(|c| c.get(vertex_offset).copied()).collect();
            let is_triangles = primitive.has_tag_name_any("triangles");
            let mut rest = all.as_slice();
            let mut sizes = counts.iter().flatten();
            while !rest.is_empty() {
                let whole = if is_triangles { 3 } else { rest.len() };
                let size = if counts.is_some() { sizes.next().copied().unwrap_or(usize::MAX) } else { whole };
                let (face, after) = rest
                    .split_at_checked(size)
                    .filter(|(face, _)| !face.is_empty())
                    .ok_or_else(|| self.fault(indices, "the number of indices does not fit the faces"))?;
                rest = after;
                corners.clear();
                corners.extend(face.iter().map(|index| index.saturating_add(first)));
                if mirrored {
                    corners.reverse();
                }
                mesh.add_polygon(&corners, colour, self.at(indices))?;
            }
        }
        Ok(())
    }

    /// The coordinates that `<vertices>` stand for.
    fn positions(&self, vertices: Node<'a, 'a>) -> Result<Vec<f64>, Fault> {
        let mut inputs = vertices.children().filter(|node| node.has_tag_name_any("input"));
        let position = inputs.find(|input| input.attribute("semantic") == Some("POSITION"));
        let source = match position {
            Some(input) => self.referred(input, "source")?,
            None => return Err(self.fault(vertices, "<vertices> without an input of semantic POSITION")),
        };
        let array = source.child("float_array");
        let array = array.ok_or_else(|| self.fault(source, "<source> without <float_array>"))?;
        let numbers: Vec<f64> = self.numbers(array)?;
        let stride = source.descendants().find(|node| node.has_tag_name_any("accessor"));
        let stride = stride.and_then(|node| node.attribute("stride")?.parse().ok()).unwrap_or(3_usize);
        if stride == 3 {
            return Ok(numbers);
        }
        if stride < 3 {
            return Err(self.fault(source, format!("positions of {stride} numbers; three are needed")));
        }
        Ok(numbers.chunks_exact(stride).flat_map(|c| [c[0], c[1], c[2]]).collect())
    }
}
