//! How a column lies in a file: its leaf, its levels, its type.

use std::path::Path;

use parquet::basic::{ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::schema::types::{SchemaDescriptor, Type};

use super::Kind;
use crate::recording::RecordingError;

/// Where the cells of a column are, and what its levels say (Dremel's, as the format defines them).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Number of the leaf in the file.
    pub leaf: usize,
    /// Definition level from which a cell is not null.
    pub cell: i16,
    /// Definition level from which a cell has an item; a scalar is the only item of its cell.
    pub item: i16,
    /// Definition level at which there is a value.
    pub value: i16,
}

/// Finds a column and refuses one that cannot hold what it must.
pub(super) fn layout(
    file: &Path,
    schema: &SchemaDescriptor,
    column: &'static str,
    kind: Kind,
) -> Result<Layout, RecordingError> {
    let root = schema.root_schema();
    let leaves: Vec<usize> =
        (0..schema.num_columns()).filter(|&leaf| schema.get_column_root(leaf).name() == column).collect();
    let &[leaf, ..] = leaves.as_slice() else {
        let names: Vec<&str> = root.get_fields().iter().map(|field| field.name()).collect();
        return Err(RecordingError::MissingColumn { file: file.into(), column, present: names.join(", ") });
    };
    let field = schema.get_column_root(leaf);
    let path = path(field);
    let found = match &path {
        Some(path) if leaves.len() == 1 => type_name(path),
        _ => "a group".to_string(),
    };
    match path {
        Some(path) if leaves.len() == 1 && accepts(kind, &path) => Ok(levels(leaf, &path)),
        _ => Err(RecordingError::ColumnType { file: file.into(), column, found, expected: kind.name() }),
    }
}

/// From the field to its only leaf; `None` where a group on the way has several.
fn path(field: &Type) -> Option<Vec<&Type>> {
    let mut path = vec![field];
    while let Type::GroupType { fields, .. } = path[path.len() - 1] {
        match fields.as_slice() {
            [only] => path.push(only),
            _ => return None,
        }
    }
    Some(path)
}

fn repetition(node: &Type) -> Repetition {
    let info = node.get_basic_info();
    if info.has_repetition() { info.repetition() } else { Repetition::REQUIRED }
}

fn lists(path: &[&Type]) -> usize {
    path.iter().filter(|node| repetition(node) == Repetition::REPEATED).count()
}

fn levels(leaf: usize, path: &[&Type]) -> Layout {
    let adds = |node: &&&Type| repetition(node) != Repetition::REQUIRED;
    let value = path.iter().filter(adds).count() as i16;
    match path.iter().position(|node| repetition(node) == Repetition::REPEATED) {
        None => Layout { leaf, cell: value, item: value, value },
        Some(at) => {
            let cell = path[..at].iter().filter(adds).count() as i16;
            Layout { leaf, cell, item: cell + 1, value }
        }
    }
}

/// Scalars are leaves of their own; lists repeat once, in any nesting of groups with one field.
fn accepts(kind: Kind, path: &[&Type]) -> bool {
    let leaf = path[path.len() - 1];
    let (scalar, list) = (path.len() == 1 && lists(path) == 0, lists(path) == 1);
    match kind {
        Kind::Integer => scalar && is_integer(leaf),
        Kind::Number => scalar && (is_integer(leaf) || is_float(leaf)),
        Kind::Text => scalar && is_text(leaf),
        Kind::Numbers => list && is_float(leaf),
        Kind::Texts => list && is_text(leaf),
    }
}

/// Signed: other meanings of these bits (dates, decimals, unsigned) have a logical or a converted type.
fn is_integer(leaf: &Type) -> bool {
    let info = leaf.get_basic_info();
    let signed = match info.logical_type_ref() {
        None => {
            use ConvertedType::*;
            matches!(info.converted_type(), NONE | INT_8 | INT_16 | INT_32 | INT_64)
        }
        Some(LogicalType::Integer(integer)) => integer.is_signed,
        Some(_) => false,
    };
    signed && matches!(leaf.get_physical_type(), Physical::INT32 | Physical::INT64)
}

fn is_float(leaf: &Type) -> bool {
    matches!(leaf.get_physical_type(), Physical::FLOAT | Physical::DOUBLE)
}

fn is_text(leaf: &Type) -> bool {
    let info = leaf.get_basic_info();
    let text =
        info.logical_type_ref() == Some(&LogicalType::String) || info.converted_type() == ConvertedType::UTF8;
    text && leaf.get_physical_type() == Physical::BYTE_ARRAY
}

/// The type in the words of the format of sites.
fn type_name(path: &[&Type]) -> String {
    let leaf = path[path.len() - 1];
    let name = match leaf.get_physical_type() {
        Physical::INT32 if is_integer(leaf) => "int32".into(),
        Physical::INT64 if is_integer(leaf) => "int64".into(),
        Physical::FLOAT => "float32".into(),
        Physical::DOUBLE => "float64".into(),
        Physical::BYTE_ARRAY if is_text(leaf) => "string".into(),
        Physical::BOOLEAN => "boolean".into(),
        physical => match leaf.get_basic_info().logical_type_ref() {
            Some(logical) => format!("{logical:?} in {physical}"),
            None => format!("bare {physical}"),
        },
    };
    (0..lists(path)).fold(name, |name, _| format!("list<{name}>"))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use parquet::schema::parser::parse_message_type;

    use super::*;

    fn found(field: &str, kind: Kind) -> Result<Layout, String> {
        let schema = parse_message_type(&format!("message m {{ optional double a; {field} }}")).unwrap();
        layout(Path::new("f"), &SchemaDescriptor::new(Arc::new(schema)), "x", kind).map_err(|e| e.to_string())
    }

    /// Levels by the format's description of nested types (parquet-format, LogicalTypes.md and Encodings.md).
    #[test]
    fn reference_levels_of_scalars_and_lists() {
        let at = |cell, item, value| Ok(Layout { leaf: 1, cell, item, value });
        assert_eq!(found("required double x;", Kind::Number), at(0, 0, 0));
        assert_eq!(found("optional int64 x;", Kind::Integer), at(1, 1, 1));
        let standard = "optional group x (LIST) { repeated group list { optional float element; } }";
        assert_eq!(found(standard, Kind::Numbers), at(1, 2, 3));
        let strict = "required group x (LIST) { repeated group list { required double element; } }";
        assert_eq!(found(strict, Kind::Numbers), at(0, 1, 1));
        let two_levels = "optional group x (LIST) { repeated double array; }";
        assert_eq!(found(two_levels, Kind::Numbers), at(1, 2, 2));
        assert_eq!(found("repeated binary x (STRING);", Kind::Texts), at(0, 1, 1));
    }

    #[test]
    fn regress_other_meanings_of_the_same_bits_are_refused() {
        for (field, kind, word) in [
            ("optional int32 x (DATE);", Kind::Integer, "Date"),
            ("optional int32 x (INTEGER(32,false));", Kind::Number, "Integer"),
            ("optional binary x;", Kind::Text, "bare BYTE_ARRAY"),
            ("optional double x;", Kind::Numbers, "float64"),
            ("optional group x { optional double y; optional double z; }", Kind::Number, "a group"),
            ("optional group x { optional double y; }", Kind::Number, "float64"),
            (
                "optional group x (LIST) { repeated group list { optional group element (LIST) { repeated group list { optional double element; } } } }",
                Kind::Numbers,
                "list<list<float64>>",
            ),
        ] {
            let error = found(field, kind).unwrap_err();
            assert!(error.contains(word) && error.contains(kind.name()), "{error}");
        }
    }
}
