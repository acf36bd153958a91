//! `--set KEY=VALUE`.

use toml_edit::{DocumentMut, Item, Table, Value};

/// Puts one override into the document.
///
/// # Errors
/// A sentence that says what is wrong with it.
pub(super) fn apply(document: &mut DocumentMut, setting: &str) -> Result<(), String> {
    let Some((path, value)) = setting.split_once('=') else {
        return Err(format!("--set {setting}: write KEY=VALUE, for example alignment.registration=point_to_point"));
    };
    let keys: Vec<&str> = path.trim().split('.').collect();
    if keys.iter().any(|k| k.is_empty()) {
        return Err(format!("--set {setting}: '{path}' is not a key; write TABLE.KEY=VALUE"));
    }
    let Some((last, tables)) = keys.split_last() else { return Ok(()) };
    let mut table: &mut Table = document.as_table_mut();
    for key in tables {
        let item = table.entry(key).or_insert_with(|| Item::Table(Table::new()));
        table = item.as_table_mut().ok_or_else(|| format!("--set {setting}: '{key}' is a value, not a table"))?;
    }
    table.insert(last, Item::Value(parse_value(value.trim())));
    Ok(())
}

/// A TOML value; a word that is none is a string, so that quotes can be left out on the command line.
fn parse_value(text: &str) -> Value {
    text.parse().unwrap_or_else(|_| Value::from(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(setting: &str) -> String {
        let mut document: DocumentMut = "[graph]\nlockstep = true\n".parse().unwrap();
        apply(&mut document, setting).unwrap();
        document.to_string()
    }

    #[test]
    fn a_value_is_replaced_and_a_table_is_made_when_missing() {
        assert!(applied("graph.lockstep=false").contains("lockstep = false"));
        assert!(applied("alignment.registration=point_to_plane").contains("registration = \"point_to_plane\""));
        assert!(applied("graph.cores=[0, 1]").contains("cores = [0, 1]"));
    }

    #[test]
    fn a_setting_without_a_value_is_refused_with_an_example() {
        let mut document = DocumentMut::new();
        assert!(apply(&mut document, "graph.lockstep").unwrap_err().contains("KEY=VALUE"));
        assert!(apply(&mut document, "graph..x=1").unwrap_err().contains("not a key"));
    }
}
