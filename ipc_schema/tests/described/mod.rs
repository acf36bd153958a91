//! Topics and layouts as they describe themselves, taken apart for tests that write them down elsewhere.

#![allow(dead_code, reason = "every test target uses another part of it")]

use std::collections::BTreeMap;

use mirador_ipc_schema::topics::TopicInfo;

/// A type as the description of a layout writes it.
pub enum Type {
    Primitive(String),
    Array(Box<Type>, String),
    Struct(Record),
}

/// A struct of the description.
pub struct Record {
    pub name: String,
    pub size: String,
    pub fields: Vec<Field>,
}

/// A field of a struct.
pub struct Field {
    pub name: String,
    pub offset: String,
    pub kind: Type,
}

impl Type {
    /// Bytes.
    pub fn size(&self) -> usize {
        match self {
            Self::Primitive(name) => name[1..].parse::<usize>().unwrap() / 8,
            Self::Array(item, length) => item.size() * length.parse::<usize>().unwrap(),
            Self::Struct(record) => record.size.parse().unwrap(),
        }
    }

    /// The structs in it, each before those that hold it.
    pub fn records<'a>(&'a self, found: &mut Vec<&'a Record>) {
        match self {
            Self::Primitive(_) => {}
            Self::Array(item, _) => item.records(found),
            Self::Struct(record) => {
                for field in &record.fields {
                    field.kind.records(found);
                }
                found.push(record);
            }
        }
    }
}

/// The sources of the layouts: a field's meaning is its comment there.
pub const SOURCES: [&str; 9] = [
    include_str!("../../src/messages/mod.rs"),
    include_str!("../../src/messages/header.rs"),
    include_str!("../../src/messages/scan.rs"),
    include_str!("../../src/messages/sensors.rs"),
    include_str!("../../src/messages/motion.rs"),
    include_str!("../../src/messages/alignment.rs"),
    include_str!("../../src/messages/analysis.rs"),
    include_str!("../../src/messages/planning.rs"),
    include_str!("../../src/messages/health.rs"),
];

/// The comments of structs (`Name`) and of their fields (`Name.field`), each on one line.
pub fn meanings() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for source in SOURCES {
        let (mut comment, mut name) = (Vec::new(), String::new());
        for line in source.lines().map(str::trim) {
            if let Some(text) = line.strip_prefix("///") {
                comment.push(text.trim());
                continue;
            }
            let item = line.strip_prefix("pub ").and_then(|rest| rest.split_once(": "));
            let key = match item {
                Some((left, _)) if left.starts_with("struct ") => {
                    name = left["struct ".len()..].to_owned();
                    Some(name.clone())
                }
                Some((field, _)) if !field.contains(' ') => Some(format!("{name}.{field}")),
                _ => None,
            };
            if let Some(key) = key {
                // Links of rustdoc become plain code.
                found.insert(key, comment.join(" ").replace("[`", "`").replace("`]", "`").replace('|', "\\|"));
            }
            comment.clear();
        }
    }
    found
}

/// Takes a description apart, from front to back. Descriptions have no blanks and a fixed order of keys.
pub struct Reader<'a>(pub &'a str);

impl Reader<'_> {
    pub fn accept(&mut self, text: &str) -> bool {
        let rest = self.0.strip_prefix(text);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    pub fn expect(&mut self, text: &str) {
        assert!(self.accept(text), "the description should go on with {text}: {}", self.0);
    }

    pub fn until(&mut self, end: &str) -> String {
        let (text, rest) = self.0.split_once(end).unwrap_or_else(|| panic!("the description should hold {end}"));
        self.0 = rest;
        text.to_owned()
    }

    pub fn kind(&mut self) -> Type {
        if self.accept("{\"array\":") {
            let item = self.kind();
            self.expect(",\"len\":");
            return Type::Array(Box::new(item), self.until("}"));
        }
        if self.accept("{\"struct\":\"") {
            let name = self.until("\",\"size\":");
            let size = self.until(",\"fields\":[");
            return Type::Struct(Record { name, size, fields: self.fields() });
        }
        self.expect("\"");
        Type::Primitive(self.until("\""))
    }

    pub fn fields(&mut self) -> Vec<Field> {
        let mut fields = Vec::new();
        while !self.accept("]}") {
            self.accept(",");
            self.expect("{\"name\":\"");
            let name = self.until("\",\"offset\":");
            let offset = self.until(",\"type\":");
            fields.push(Field { name, offset, kind: self.kind() });
            self.expect("}");
        }
        fields
    }
}

/// Meta and item of a topic.
pub fn parts(topic: &TopicInfo) -> [Type; 2] {
    let text = (topic.describe)();
    let mut reader = Reader(&text);
    reader.expect("{\"topic\":\"");
    assert_eq!(reader.until("\",\"meta\":"), topic.rules.name);
    let meta = reader.kind();
    reader.expect(",\"item\":");
    let item = reader.kind();
    reader.expect("}");
    [meta, item]
}

/// `ScanMeta` of `mirador/ScanMeta/1`.
pub fn short(name: &str) -> &str {
    name.trim_start_matches("mirador/").split('/').next().unwrap()
}
