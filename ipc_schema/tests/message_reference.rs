//! `docs/messages.md` says what the code says: its generated section is compared with the topics and layouts.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use mirador_ipc_schema::topics::{ALL, Capacity, Lag, TopicInfo};

const BEGIN: &str = "<!-- generated: begin -->";
const END: &str = "<!-- generated: end -->";

/// A type as the description of a layout writes it.
enum Type {
    Primitive(String),
    Array(Box<Type>, String),
    Struct(Record),
}

/// A struct of the description.
struct Record {
    name: String,
    size: String,
    fields: Vec<Field>,
}

/// A field of a struct.
struct Field {
    name: String,
    offset: String,
    kind: Type,
}

impl Type {
    /// As it stands in the tables.
    fn words(&self) -> String {
        match self {
            Self::Primitive(name) => name.clone(),
            Self::Array(item, length) => format!("{}[{length}]", item.words()),
            Self::Struct(record) => format!("[{0}](#{1})", short(&record.name), anchor(&record.name)),
        }
    }

    /// Bytes.
    fn size(&self) -> usize {
        match self {
            Self::Primitive(name) => name[1..].parse::<usize>().unwrap() / 8,
            Self::Array(item, length) => item.size() * length.parse::<usize>().unwrap(),
            Self::Struct(record) => record.size.parse().unwrap(),
        }
    }

    /// The structs in it, each before those that hold it.
    fn records<'a>(&'a self, found: &mut Vec<&'a Record>) {
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
const SOURCES: [&str; 9] = [
    include_str!("../src/messages/mod.rs"),
    include_str!("../src/messages/header.rs"),
    include_str!("../src/messages/scan.rs"),
    include_str!("../src/messages/sensors.rs"),
    include_str!("../src/messages/motion.rs"),
    include_str!("../src/messages/alignment.rs"),
    include_str!("../src/messages/analysis.rs"),
    include_str!("../src/messages/planning.rs"),
    include_str!("../src/messages/health.rs"),
];

/// The comments of structs (`Name`) and of their fields (`Name.field`), each on one line.
fn meanings() -> BTreeMap<String, String> {
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
struct Reader<'a>(&'a str);

impl Reader<'_> {
    fn accept(&mut self, text: &str) -> bool {
        let rest = self.0.strip_prefix(text);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    fn expect(&mut self, text: &str) {
        assert!(self.accept(text), "the description should go on with {text}: {}", self.0);
    }

    fn until(&mut self, end: &str) -> String {
        let (text, rest) = self.0.split_once(end).unwrap_or_else(|| panic!("the description should hold {end}"));
        self.0 = rest;
        text.to_owned()
    }

    fn kind(&mut self) -> Type {
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

    fn fields(&mut self) -> Vec<Field> {
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
fn parts(topic: &TopicInfo) -> [Type; 2] {
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
fn short(name: &str) -> &str {
    name.trim_start_matches("mirador/").split('/').next().unwrap()
}

/// The anchor that a heading of the name gets.
fn anchor(name: &str) -> String {
    short(name).to_lowercase()
}

fn topic_table() -> String {
    let mut out = String::from(
        "| topic | from | meta | items | most items | pub | sub | buffer | borrowed | history | loaned | lag |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for topic in ALL {
        let r = &topic.rules;
        let [meta, item] = parts(topic);
        let publisher = if r.publisher.is_empty() { "any" } else { r.publisher };
        let lag = match r.lag {
            Lag::Wait => "wait",
            Lag::DropOldest => "drop",
            Lag::Supersede => "supersede",
        };
        let capacity = match r.capacity {
            Capacity::Fixed(n) => n.to_string(),
            Capacity::Scan => "scan".into(),
            Capacity::Keyframes => "keyframes".into(),
        };
        writeln!(
            out,
            "| `{}` | {publisher} | {} | {} | {capacity} | {} | {} | {} | {} | {} | {} | {lag} |",
            r.name,
            meta.words(),
            item.words(),
            r.publishers,
            r.subscribers,
            r.buffer,
            r.borrowed,
            r.history,
            r.loaned
        )
        .unwrap();
    }
    out
}

fn field_tables() -> String {
    let mut out = String::new();
    let mut done = BTreeSet::new();
    let meanings = meanings();
    let meaning = |key: &str| meanings.get(key).unwrap_or_else(|| panic!("{key} has no comment")).clone();
    for topic in ALL {
        let parts = parts(topic);
        let mut records = Vec::new();
        for part in &parts {
            part.records(&mut records);
        }
        for record in records.into_iter().filter(|r| done.insert(r.name.clone())) {
            let name = short(&record.name);
            write!(out, "\n### {name}\n\n{}\n\n", meaning(name)).unwrap();
            write!(out, "Type name `{}`, {} bytes.\n\n", record.name, record.size).unwrap();
            out.push_str("| offset | bytes | type | field | meaning |\n|---|---|---|---|---|\n");
            for f in &record.fields {
                let (size, kind) = (f.kind.size(), f.kind.words());
                let meaning = meaning(&format!("{name}.{}", f.name));
                writeln!(out, "| {} | {size} | {kind} | `{}` | {meaning} |", f.offset, f.name).unwrap();
            }
        }
    }
    out
}

fn generated() -> String {
    format!("\n## Topics and delivery rules\n\n{}\n## Fields\n{}\n", topic_table(), field_tables())
}

#[test]
fn the_message_reference_says_what_the_code_says() {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/messages.md"));
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (before, rest) = text.split_once(BEGIN).unwrap_or_else(|| panic!("{} lacks {BEGIN}", path.display()));
    let (written, after) = rest.split_once(END).unwrap_or_else(|| panic!("{} lacks {END}", path.display()));
    let right = generated();
    if written == right {
        return;
    }
    if std::env::var("MIRADOR_BLESS").is_ok_and(|v| v == "1") {
        fs::write(&path, format!("{before}{BEGIN}{right}{END}{after}")).unwrap();
        return;
    }
    let line = written.lines().zip(right.lines()).find(|(a, b)| a != b);
    panic!("{} differs from the code, first at {line:?}: run with MIRADOR_BLESS=1 to rewrite", path.display());
}

#[test]
fn a_description_is_taken_apart_into_nested_fields() {
    let text = "{\"struct\":\"mirador/A/1\",\"size\":12,\"fields\":[\
                {\"name\":\"a\",\"offset\":0,\"type\":{\"array\":\"u16\",\"len\":2}},\
                {\"name\":\"b\",\"offset\":4,\"type\":{\"struct\":\"mirador/B/1\",\"size\":8,\"fields\":[\
                {\"name\":\"c\",\"offset\":0,\"type\":\"f64\"}]}}]}";
    let Type::Struct(record) = Reader(text).kind() else { panic!("a struct") };
    assert_eq!((record.name.as_str(), record.fields.len()), ("mirador/A/1", 2));
    assert_eq!(record.fields[0].kind.words(), "u16[2]");
    assert_eq!((record.fields[0].kind.size(), record.fields[1].kind.size()), (4, 8));
    assert_eq!(record.fields[1].kind.words(), "[B](#b)");
}
