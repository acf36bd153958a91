//! PLY clouds: ascii, binary_little_endian and binary_big_endian, any vertex properties.

use super::{
    cloud_reader::{CountHint, Record, RecordReader},
    error::{At, FormatError},
    scalar::{Endian, FieldAt, RecordBuilder, Role, Scalar, record_from_bytes},
    source::{Source, quoted},
};

/// A header longer than this is damage.
const MOST_HEADER_LINES: usize = 4096;

#[derive(Debug, Clone, Copy)]
enum Property {
    Scalar { scalar: Scalar, role: Role },
    List { count: Scalar, item: Scalar },
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Reads the `vertex` element; elements before it are skipped, those after it are not looked at.
pub(super) struct PlyReader {
    source: Source,
    /// `None` is ascii.
    endian: Option<Endian>,
    properties: Vec<Property>,
    /// The scalars of a binary vertex, lists left out.
    fields: Vec<FieldAt>,
    /// One vertex without its lists, reused.
    record: Vec<u8>,
    /// Vertices still to come.
    left: usize,
    count: CountHint,
}

impl PlyReader {
    pub(super) fn new(mut source: Source) -> Result<Self, FormatError> {
        let (endian, elements) = read_header(&mut source)?;
        for element in elements {
            if element.name == "vertex" {
                return Self::at_vertices(source, endian, element);
            }
            skip_element(&mut source, endian, &element)?;
        }
        Err(source.malformed_line("the header", "without an element vertex".into(), "`element vertex COUNT`"))
    }

    fn at_vertices(source: Source, endian: Option<Endian>, vertex: Element) -> Result<Self, FormatError> {
        for role in [Role::X, Role::Y, Role::Z] {
            let is_role = |p: &&Property| matches!(p, Property::Scalar { role: r, .. } if *r == role);
            if vertex.properties.iter().filter(is_role).count() != 1 {
                let found = format!("without exactly one {role:?}");
                return Err(source.malformed_line("element vertex", found, "properties x, y and z, once each"));
            }
        }
        let mut offset = 0;
        let mut fields = Vec::new();
        let mut least = 0;
        for property in &vertex.properties {
            match *property {
                Property::Scalar { scalar, role } => {
                    fields.push(FieldAt { role, scalar, offset });
                    offset += scalar.size();
                    least += if endian.is_some() { scalar.size() } else { 2 };
                }
                Property::List { count, .. } => least += if endian.is_some() { count.size() } else { 2 },
            }
        }
        source.check_holds(vertex.count, least, "vertices")?;
        fields.retain(|field| field.role != Role::Other);
        let count = if source.is_packed() { CountHint::AtMost(vertex.count) } else { CountHint::Exact(vertex.count) };
        let (record, left) = (vec![0; offset], vertex.count);
        Ok(Self { source, endian, properties: vertex.properties, fields, record, left, count })
    }

    fn next_binary(&mut self, endian: Endian) -> Result<Record, FormatError> {
        if !self.properties.iter().any(|p| matches!(p, Property::List { .. })) {
            self.source.read_exact(&mut self.record, "a vertex")?;
            return Ok(record_from_bytes(&self.fields, &self.record, endian));
        }
        let mut offset = 0;
        for property in &self.properties {
            match *property {
                Property::Scalar { scalar, .. } => {
                    let end = offset + scalar.size();
                    self.source.read_exact(self.record.get_mut(offset..end).unwrap_or(&mut []), "a vertex")?;
                    offset = end;
                }
                Property::List { count, item } => skip_list(&mut self.source, endian, count, item)?,
            }
        }
        Ok(record_from_bytes(&self.fields, &self.record, endian))
    }

    fn next_ascii(&mut self) -> Result<Record, FormatError> {
        if !next_nonblank(&mut self.source)? {
            return Err(self.source.truncated(format!("{} more vertices, one a line", self.left)));
        }
        let source = &self.source;
        let mut tokens = source.tokens();
        let mut record = RecordBuilder::new();
        let too_few = || source.malformed_line("the vertex", quoted(source.line()), "one value a property");
        for property in &self.properties {
            let token = tokens.next().ok_or_else(too_few)?;
            match *property {
                Property::Scalar { role, .. } => record.set(role, source.number(token, "a vertex property")?),
                Property::List { .. } => {
                    let items = source.number(token, "the length of a list")?;
                    // A length that is negative or not a number counts as 0 and then leaves a value too many.
                    for _ in 0..items as usize {
                        tokens.next().ok_or_else(too_few)?;
                    }
                }
            }
        }
        if tokens.next().is_some() {
            return Err(too_few());
        }
        Ok(record.build())
    }
}

impl RecordReader for PlyReader {
    fn count(&self) -> CountHint {
        self.count
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        if self.left == 0 {
            return Ok(None);
        }
        let record = match self.endian {
            Some(endian) => self.next_binary(endian)?,
            None => self.next_ascii()?,
        };
        self.left -= 1;
        Ok(Some(record))
    }
}

fn next_nonblank(source: &mut Source) -> Result<bool, FormatError> {
    while source.next_line()? {
        if !source.line().is_empty() {
            return Ok(true);
        }
    }
    Ok(false)
}

fn skip_list(source: &mut Source, endian: Endian, count: Scalar, item: Scalar) -> Result<(), FormatError> {
    let mut length = [0_u8; 8];
    let length = length.get_mut(..count.size()).unwrap_or(&mut []);
    source.read_exact(length, "the length of a list")?;
    let items = count.read(length, endian);
    if !(items >= 0.0 && items.fract() == 0.0) {
        return Err(FormatError::Malformed {
            path: source.path().to_path_buf(),
            at: At::Byte(source.consumed()),
            field: "the length of a list",
            found: items.to_string(),
            expected: "a whole number, 0 or more".into(),
        });
    }
    source.skip((items as u64).saturating_mul(item.size() as u64), "a list")
}

fn skip_element(source: &mut Source, endian: Option<Endian>, element: &Element) -> Result<(), FormatError> {
    let Some(endian) = endian else {
        for _ in 0..element.count {
            if !next_nonblank(source)? {
                return Err(source.truncated(format!("{} lines of element {}", element.count, element.name)));
            }
        }
        return Ok(());
    };
    let fixed: usize = element.properties.iter().map_while(scalar_size).sum();
    if element.properties.iter().all(|p| scalar_size(p).is_some()) {
        return source.skip((element.count as u64).saturating_mul(fixed as u64), "an element before the vertices");
    }
    for _ in 0..element.count {
        for property in &element.properties {
            match *property {
                Property::Scalar { scalar, .. } => {
                    source.skip(scalar.size() as u64, "an element before the vertices")?
                }
                Property::List { count, item } => skip_list(source, endian, count, item)?,
            }
        }
    }
    Ok(())
}

fn scalar_size(property: &Property) -> Option<usize> {
    match property {
        Property::Scalar { scalar, .. } => Some(scalar.size()),
        Property::List { .. } => None,
    }
}

/// The byte order (`None`: ascii) and the elements.
fn read_header(source: &mut Source) -> Result<(Option<Endian>, Vec<Element>), FormatError> {
    if !source.next_line()? || source.line() != b"ply" {
        return Err(source.malformed_line("the first line", quoted(source.line()), "`ply`"));
    }
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    for _ in 0..MOST_HEADER_LINES {
        if !source.next_line()? {
            return Err(source.truncated("a header up to `end_header`".into()));
        }
        let line = source.line_text();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let wrong = |expected| source.malformed_line("the header", quoted(source.line()), expected);
        match words.as_slice() {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, ..] => {
                format = Some(match *name {
                    "ascii" => None,
                    "binary_little_endian" => Some(Endian::Little),
                    "binary_big_endian" => Some(Endian::Big),
                    _ => return Err(wrong("`format` ascii, binary_little_endian or binary_big_endian")),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| wrong("`element NAME COUNT` with a whole number"))?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let property = property_from(rest).ok_or_else(|| wrong("`property TYPE NAME` of a known type"))?;
                let element = elements.last_mut().ok_or_else(|| wrong("an `element` before its properties"))?;
                element.properties.push(property);
            }
            ["end_header"] => {
                let format = format.ok_or_else(|| wrong("a `format` line before the end"))?;
                return Ok((format, elements));
            }
            _ => return Err(wrong("format, element, property, comment or end_header")),
        }
    }
    Err(source.malformed_line("the header", format!("longer than {MOST_HEADER_LINES} lines"), "a PLY header"))
}

fn property_from(words: &[&str]) -> Option<Property> {
    match words {
        ["list", count, item, _] => Some(Property::List { count: scalar_of(count)?, item: scalar_of(item)? }),
        [scalar, name] => Some(Property::Scalar { scalar: scalar_of(scalar)?, role: Role::of_name(name) }),
        _ => None,
    }
}

fn scalar_of(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" => Scalar::I64,
        "uint64" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}
