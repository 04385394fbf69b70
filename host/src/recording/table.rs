//! Columns of an Arrow record batch by name, widened where nothing is lost.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::{DataType, Schema};

use super::RecordingError;

const INTEGER: &str = "int32";
const NUMBER: &str = "float64";
const TEXT: &str = "string";
const TEXTS: &str = "list<string>";
const NUMBERS: &str = "list<float32> or list<float64>";

/// What a column must hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Integer,
    Number,
    Text,
    Numbers,
    Texts,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Integer => INTEGER,
            Kind::Number => NUMBER,
            Kind::Text => TEXT,
            Kind::Numbers => NUMBERS,
            Kind::Texts => TEXTS,
        }
    }

    fn accepts(self, found: &DataType) -> bool {
        use DataType::*;
        match (self, found) {
            (Kind::Integer, Int32 | Int64) | (Kind::Text, Utf8 | LargeUtf8 | Utf8View) => true,
            (Kind::Number, Float64 | Float32 | Int32 | Int64) => true,
            (Kind::Numbers, List(item) | LargeList(item)) => {
                matches!(item.data_type(), Float32 | Float64)
            }
            (Kind::Texts, List(item)) => *item.data_type() == Utf8,
            _ => false,
        }
    }
}

/// Refuses a schema in which a column is missing or has another type.
pub(crate) fn check_schema(
    file: &Path,
    schema: &Schema,
    columns: &[(&'static str, Kind)],
) -> Result<(), RecordingError> {
    for &(column, kind) in columns {
        let Ok(field) = schema.field_with_name(column) else {
            let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
            return Err(RecordingError::MissingColumn {
                file: file.into(),
                column,
                present: names.join(", "),
            });
        };
        if !kind.accepts(field.data_type()) {
            return Err(RecordingError::ColumnType {
                file: file.into(),
                column,
                found: field.data_type().to_string(),
                expected: kind.name(),
            });
        }
    }
    Ok(())
}

/// Cells of one batch whose schema has passed [`check_schema`]; `None` is a null.
pub(crate) struct Cells<'a>(pub(crate) &'a RecordBatch);

impl Cells<'_> {
    fn column(&self, name: &str) -> Option<&ArrayRef> {
        self.0.column_by_name(name)
    }

    fn cell(&self, name: &str, row: usize) -> Option<&ArrayRef> {
        self.column(name).filter(|array| row < array.len() && array.is_valid(row))
    }

    pub(crate) fn integer(&self, name: &str, row: usize) -> Option<i64> {
        let array = self.cell(name, row)?;
        match array.data_type() {
            DataType::Int32 => Some(array.as_primitive::<Int32Type>().value(row).into()),
            DataType::Int64 => Some(array.as_primitive::<Int64Type>().value(row)),
            _ => None,
        }
    }

    pub(crate) fn number(&self, name: &str, row: usize) -> Option<f64> {
        let array = self.cell(name, row)?;
        match array.data_type() {
            DataType::Float64 => Some(array.as_primitive::<Float64Type>().value(row)),
            DataType::Float32 => Some(array.as_primitive::<Float32Type>().value(row).into()),
            _ => self.integer(name, row).map(|value| value as f64),
        }
    }

    pub(crate) fn text(&self, name: &str, row: usize) -> Option<String> {
        let array = self.cell(name, row)?;
        match array.data_type() {
            DataType::Utf8 => Some(array.as_string::<i32>().value(row).into()),
            DataType::LargeUtf8 => Some(array.as_string::<i64>().value(row).into()),
            DataType::Utf8View => Some(array.as_string_view().value(row).into()),
            _ => None,
        }
    }

    /// The items of a list cell.
    pub(crate) fn list(&self, name: &str, row: usize) -> Option<ArrayRef> {
        let array = self.cell(name, row)?;
        match array.data_type() {
            DataType::List(_) => Some(array.as_list::<i32>().value(row)),
            DataType::LargeList(_) => Some(array.as_list::<i64>().value(row)),
            _ => None,
        }
    }

    /// The items of a list cell as float64; a null item becomes NaN.
    pub(crate) fn numbers(&self, name: &str, row: usize) -> Option<Vec<f64>> {
        self.list(name, row).map(|items| match items.data_type() {
            DataType::Float32 => {
                items.as_primitive::<Float32Type>().iter().map(|v| v.map_or(f64::NAN, f64::from)).collect()
            }
            _ => items.as_primitive::<Float64Type>().iter().map(|v| v.unwrap_or(f64::NAN)).collect(),
        })
    }
}
