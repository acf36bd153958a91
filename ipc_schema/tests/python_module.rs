//! `python/mirador_messages/schema.py` says what the code says: it is compared with the topics and layouts.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod described;

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use described::{Record, SOURCES, Type, meanings, parts, short};
use mirador_ipc_schema::layout;
use mirador_ipc_schema::topics::{ALL, Capacity, Lag, registration_schema};

const HEAD: &str = "\
\"\"\"Every message, topic and constant of mirador.

Generated from ipc_schema by its test `python_module`; do not edit. A record is what lies in shared memory: its fields are
read in place.
\"\"\"

import ctypes

from .topic import Record, Topic

";

/// A type as ctypes names it.
fn ctype(kind: &Type) -> String {
    match kind {
        Type::Primitive(name) => match name.as_str() {
            "f32" => "ctypes.c_float".into(),
            "f64" => "ctypes.c_double".into(),
            integer if integer.starts_with('u') => format!("ctypes.c_uint{}", &integer[1..]),
            integer => format!("ctypes.c_int{}", &integer[1..]),
        },
        Type::Array(item, length) => format!("{} * {length}", ctype(item)),
        Type::Struct(record) => short(&record.name).into(),
    }
}

/// Plain code without the marks of Markdown that a docstring does not know.
fn docstring(meaning: &str) -> String {
    meaning.replace("\\|", "|").replace('\\', "\\\\").replace('"', "'")
}

fn class(record: &Record, meaning: &dyn Fn(&str) -> String) -> String {
    let name = short(&record.name);
    let mut out = format!("\nclass {name}(Record):\n    \"\"\"{}\"\"\"\n\n", docstring(&meaning(name)));
    writeln!(out, "    TYPE_NAME = \"{}\"\n    SIZE = {}", record.name, record.size).unwrap();
    out.push_str("    _fields_ = [\n");
    for field in &record.fields {
        let comment = docstring(&meaning(&format!("{name}.{}", field.name)));
        writeln!(out, "        # {comment}\n        (\"{}\", {}),", field.name, ctype(&field.kind)).unwrap();
    }
    out.push_str("    ]\n\n");
    out
}

/// The constants of the messages, each with its comment; those of a type's own carry its name.
fn constants() -> String {
    let mut out = String::new();
    for source in SOURCES {
        let (mut comment, mut prefix) = (Vec::new(), "");
        for line in source.lines() {
            let text = line.trim();
            if let Some(words) = text.strip_prefix("///") {
                comment.push(words.trim());
                continue;
            }
            if line.starts_with("impl ScanRequestKind") {
                prefix = "SCAN_REQUEST_";
            } else if line.starts_with('}') {
                prefix = "";
            }
            let constant = text.strip_prefix("pub const ").and_then(|rest| rest.split_once(": "));
            if let Some((name, rest)) = constant {
                let value = rest.split_once(" = ").unwrap().1.trim_end_matches(';');
                let comment = docstring(&comment.join(" ")).replace("[`", "`").replace("`]", "`");
                writeln!(out, "# {comment}\n{prefix}{name} = {value}").unwrap();
            }
            comment.clear();
        }
    }
    out
}

fn topics() -> String {
    let mut out = String::from("\nTOPICS = {\n    topic.name: topic\n    for topic in [\n");
    for topic in ALL {
        let r = &topic.rules;
        let [meta, item] = parts(topic).map(|part| ctype(&part));
        let capacity = match r.capacity {
            Capacity::Fixed(n) => n.to_string(),
            Capacity::Scan => "\"scan\"".into(),
            Capacity::Keyframes => "\"keyframes\"".into(),
        };
        let lag = match r.lag {
            Lag::Wait => "wait",
            Lag::DropOldest => "drop",
            Lag::Supersede => "supersede",
        };
        let hash = layout::hash(&(topic.describe)());
        writeln!(out, "        Topic(\"{}\", {meta}, {item}, \"{hash:016x}\", \"{lag}\", {capacity}),", r.name)
            .unwrap();
    }
    out.push_str("    ]\n}\n");
    out
}

fn generated() -> String {
    let mut out = HEAD.to_owned();
    let meanings = meanings();
    let meaning = |key: &str| meanings.get(key).unwrap_or_else(|| panic!("{key} has no comment")).clone();
    let mut done = BTreeSet::new();
    for topic in ALL {
        let parts = parts(topic);
        let mut records = Vec::new();
        for part in &parts {
            part.records(&mut records);
        }
        for record in records.into_iter().filter(|r| done.insert(r.name.clone())) {
            out.push_str(&class(record, &meaning));
        }
    }
    out.push_str(&topics());
    let schema = registration_schema();
    writeln!(out, "\n# What an answer to a registration request says it was made with.").unwrap();
    writeln!(out, "ANSWER_SCHEMA = 0x{schema:08x}\n").unwrap();
    out.push_str(&constants());
    out
}

#[test]
fn the_python_module_says_what_the_code_says() {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../python/mirador_messages/schema.py"));
    let right = generated();
    let written = fs::read_to_string(&path).unwrap_or_default();
    if written == right {
        return;
    }
    if std::env::var("MIRADOR_BLESS").is_ok_and(|v| v == "1") {
        fs::write(&path, right).unwrap();
        return;
    }
    let line = written.lines().zip(right.lines()).find(|(a, b)| a != b);
    panic!("{} differs from the code, first at {line:?}: run with MIRADOR_BLESS=1 to rewrite", path.display());
}
