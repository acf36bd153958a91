//! `docs/messages.md` says what the code says: its generated section is compared with the topics and layouts.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod described;

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use described::{Reader, Type, meanings, parts, short};
use mirador_ipc_schema::topics::{ALL, Capacity, Lag};

const BEGIN: &str = "<!-- generated: begin -->";
const END: &str = "<!-- generated: end -->";

/// A type as it stands in the tables.
fn words(kind: &Type) -> String {
    match kind {
        Type::Primitive(name) => name.clone(),
        Type::Array(item, length) => format!("{}[{length}]", words(item)),
        Type::Struct(record) => format!("[{0}](#{1})", short(&record.name), anchor(&record.name)),
    }
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
            words(&meta),
            words(&item),
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
                let (size, kind) = (f.kind.size(), words(&f.kind));
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
    assert_eq!(words(&record.fields[0].kind), "u16[2]");
    assert_eq!((record.fields[0].kind.size(), record.fields[1].kind.size()), (4, 8));
    assert_eq!(words(&record.fields[1].kind), "[B](#b)");
}
