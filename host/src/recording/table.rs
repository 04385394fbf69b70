//! Tables of Parquet files: what a column must hold, and the cells of some rows.
//!
//! Straight on the format's own columns and levels: a second model of columns in memory would have to be compiled by everyone who
//! builds this program, for five kinds of column.

mod layout;
mod read;
mod write;

pub(crate) use read::{for_each_batch, for_each_batch_of};
pub use write::{Column, write_columns};

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
            Kind::Integer => "int32",
            Kind::Number => "float64",
            Kind::Text => "string",
            Kind::Numbers => "list<float32> or list<float64>",
            Kind::Texts => "list<string>",
        }
    }
}

/// A list of a cell; `None` is a null among its items.
pub(crate) type List<T> = Vec<Option<T>>;

/// Cells of one column, widened where nothing is lost; `None` is a null.
enum Values {
    Integers(Vec<Option<i64>>),
    Numbers(Vec<Option<f64>>),
    Texts(Vec<Option<String>>),
    NumberLists(Vec<Option<List<f64>>>),
    TextLists(Vec<Option<List<String>>>),
}

/// Cells of some rows, by the name of the column; `None` is a null, or a column or row that is not there.
pub(crate) struct Cells {
    rows: usize,
    columns: Vec<(&'static str, Values)>,
}

impl Cells {
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    fn column(&self, name: &str) -> Option<&Values> {
        self.columns.iter().find(|column| column.0 == name).map(|column| &column.1)
    }

    pub(crate) fn integer(&self, name: &str, row: usize) -> Option<i64> {
        match self.column(name)? {
            Values::Integers(cells) => *cells.get(row)?,
            _ => None,
        }
    }

    pub(crate) fn number(&self, name: &str, row: usize) -> Option<f64> {
        match self.column(name)? {
            Values::Numbers(cells) => *cells.get(row)?,
            _ => None,
        }
    }

    pub(crate) fn text(&self, name: &str, row: usize) -> Option<&str> {
        match self.column(name)? {
            Values::Texts(cells) => cells.get(row)?.as_deref(),
            _ => None,
        }
    }

    /// The items of a list of numbers.
    pub(crate) fn list(&self, name: &str, row: usize) -> Option<&[Option<f64>]> {
        match self.column(name)? {
            Values::NumberLists(cells) => cells.get(row)?.as_deref(),
            _ => None,
        }
    }

    /// The items of a list of numbers; a null item becomes NaN.
    pub(crate) fn numbers(&self, name: &str, row: usize) -> Option<Vec<f64>> {
        self.list(name, row).map(|items| items.iter().map(|item| item.unwrap_or(f64::NAN)).collect())
    }

    /// The items of a list of texts that are not null.
    pub(crate) fn texts(&self, name: &str, row: usize) -> Option<Vec<String>> {
        match self.column(name)? {
            Values::TextLists(cells) => {
                cells.get(row)?.as_ref().map(|items| items.iter().flatten().cloned().collect())
            }
            _ => None,
        }
    }
}
