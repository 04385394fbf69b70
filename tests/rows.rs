//! Rows of Parquet files as the library's record reader gives them: a way through the file that the program itself does not take.

use std::path::Path;

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row as Record};
use parquet::schema::printer::print_schema;

/// One row; every function panics where the file is not as the test expects.
pub struct Row(Record);

/// All rows of a file.
pub fn read(file: &Path) -> Vec<Row> {
    reader(file).get_row_iter(None).expect("rows").map(|row| Row(row.expect("whole row"))).collect()
}

/// The schema in the notation of the format, white space made single.
pub fn schema(file: &Path) -> String {
    let mut text = Vec::new();
    print_schema(&mut text, reader(file).metadata().file_metadata().schema());
    String::from_utf8(text).expect("UTF-8").split_whitespace().collect::<Vec<_>>().join(" ")
}

fn reader(file: &Path) -> SerializedFileReader<std::fs::File> {
    SerializedFileReader::try_from(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

impl Row {
    fn field(&self, column: &str) -> &Field {
        let found = self.0.get_column_iter().find(|field| field.0 == column);
        found.unwrap_or_else(|| panic!("no column {column}")).1
    }

    /// A number; `None` where it is null.
    pub fn optional(&self, column: &str) -> Option<f64> {
        match self.field(column) {
            Field::Null => None,
            field => Some(number(field)),
        }
    }

    /// A number.
    pub fn number(&self, column: &str) -> f64 {
        number(self.field(column))
    }

    /// A list of numbers.
    pub fn numbers(&self, column: &str) -> Vec<f64> {
        match self.field(column) {
            Field::ListInternal(list) => list.elements().iter().map(number).collect(),
            other => panic!("column {column} holds {other}, not a list"),
        }
    }

    /// A text.
    pub fn text(&self, column: &str) -> &str {
        match self.field(column) {
            Field::Str(text) => text,
            other => panic!("column {column} holds {other}, not a text"),
        }
    }
}

fn number(field: &Field) -> f64 {
    match field {
        Field::Int(value) => f64::from(*value),
        Field::Float(value) => f64::from(*value),
        Field::Double(value) => *value,
        other => panic!("{other} is no number"),
    }
}
