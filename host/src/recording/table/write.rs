//! Writing tables, whole or not at all.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};

use crate::recording::RecordingError;
use crate::recording::files::write_atomic_with;

/// Cells of one column to be written, by the type in the file; `None` is a null.
pub enum Column<'a> {
    /// int32
    Integers(Vec<Option<i32>>),
    /// float64
    Numbers(Vec<Option<f64>>),
    /// string
    Texts(Vec<&'a str>),
    /// `list<float32>`
    SingleLists(Vec<Option<Cow<'a, [f32]>>>),
    /// `list<float64>`
    NumberLists(Vec<&'a [f64]>),
    /// `list<string>`
    TextLists(Vec<Vec<&'a str>>),
}

/// Writes one table, compressed with zstd, under its name only when it is complete.
///
/// # Errors
///
/// [`RecordingError::Io`], also where columns differ in length.
pub fn write_columns(file: &Path, columns: &[(&str, Column)]) -> std::result::Result<(), RecordingError> {
    write_atomic_with(file, |out| write(out, columns).map_err(std::io::Error::other))
}

fn write(out: &mut std::fs::File, columns: &[(&str, Column)]) -> Result<()> {
    let rows = columns.first().map_or(0, |column| column.1.len());
    if let Some((name, column)) = columns.iter().find(|column| column.1.len() != rows) {
        return Err(ParquetError::General(format!(
            "column {name} has {} rows, the first {rows}",
            column.len()
        )));
    }
    let fields = columns.iter().map(|(name, column)| column.field(name)).collect::<Result<Vec<TypePtr>>>()?;
    let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
    let compression = Compression::ZSTD(ZstdLevel::default());
    let properties = Arc::new(WriterProperties::builder().set_compression(compression).build());
    let mut writer = SerializedFileWriter::new(out, schema, properties)?;
    let mut group = writer.next_row_group()?;
    for (_, column) in columns {
        let mut leaf = group.next_column()?.ok_or(ParquetError::General("a column has no place".into()))?;
        column.write(&mut leaf)?;
        leaf.close()?;
    }
    group.close()?;
    writer.close()?;
    Ok(())
}

impl Column<'_> {
    fn len(&self) -> usize {
        match self {
            Column::Integers(cells) => cells.len(),
            Column::Numbers(cells) => cells.len(),
            Column::Texts(cells) => cells.len(),
            Column::SingleLists(cells) => cells.len(),
            Column::NumberLists(cells) => cells.len(),
            Column::TextLists(cells) => cells.len(),
        }
    }

    /// Every column may hold nulls and every list null items, so that the schema does not depend on the data.
    fn field(&self, name: &str) -> Result<TypePtr> {
        match self {
            Column::Integers(_) => leaf(name, Physical::INT32),
            Column::Numbers(_) => leaf(name, Physical::DOUBLE),
            Column::Texts(_) => leaf(name, Physical::BYTE_ARRAY),
            Column::SingleLists(_) => list(name, Physical::FLOAT),
            Column::NumberLists(_) => list(name, Physical::DOUBLE),
            Column::TextLists(_) => list(name, Physical::BYTE_ARRAY),
        }
    }

    fn write(&self, out: &mut SerializedColumnWriter) -> Result<()> {
        match self {
            Column::Integers(cells) => scalars::<Int32Type, _>(out, cells, |v| *v),
            Column::Numbers(cells) => scalars::<DoubleType, _>(out, cells, |v| *v),
            Column::Texts(cells) => {
                let cells: Vec<Option<&str>> = cells.iter().copied().map(Some).collect();
                scalars::<ByteArrayType, _>(out, &cells, |v| ByteArray::from(*v))
            }
            Column::SingleLists(cells) => {
                lists::<FloatType, _>(out, cells.iter().map(Option::as_deref), |v| *v)
            }
            Column::NumberLists(cells) => {
                lists::<DoubleType, _>(out, cells.iter().copied().map(Some), |v| *v)
            }
            Column::TextLists(cells) => {
                lists::<ByteArrayType, _>(out, cells.iter().map(|c| Some(c.as_slice())), |v| {
                    ByteArray::from(*v)
                })
            }
        }
    }
}

/// Byte arrays of this program are texts.
fn leaf(name: &str, physical: Physical) -> Result<TypePtr> {
    let text = (physical == Physical::BYTE_ARRAY).then_some(LogicalType::String);
    let builder = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
    Ok(Arc::new(builder.with_logical_type(text).build()?))
}

/// The three levels that the format prescribes for lists.
fn list(name: &str, physical: Physical) -> Result<TypePtr> {
    let items = Type::group_type_builder("list")
        .with_repetition(Repetition::REPEATED)
        .with_fields(vec![leaf("element", physical)?])
        .build()?;
    let list = Type::group_type_builder(name)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(Some(LogicalType::List))
        .with_fields(vec![Arc::new(items)])
        .build()?;
    Ok(Arc::new(list))
}

fn scalars<T: DataType, V>(
    out: &mut SerializedColumnWriter,
    cells: &[Option<V>],
    convert: impl Fn(&V) -> T::T,
) -> Result<()> {
    let definitions: Vec<i16> = cells.iter().map(|cell| cell.is_some().into()).collect();
    let values: Vec<T::T> = cells.iter().flatten().map(convert).collect();
    out.typed::<T>().write_batch(&values, Some(&definitions), None)?;
    Ok(())
}

/// Definition levels of a list that is null, of one without items, and of an item that is there.
const NULL: i16 = 0;
const EMPTY: i16 = 1;
const ITEM: i16 = 3;

fn lists<'v, T: DataType, V: 'v>(
    out: &mut SerializedColumnWriter,
    cells: impl Iterator<Item = Option<&'v [V]>>,
    convert: impl Fn(&V) -> T::T,
) -> Result<()> {
    let (mut definitions, mut repetitions, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for cell in cells {
        let items = cell.unwrap_or_default();
        if items.is_empty() {
            definitions.push(if cell.is_some() { EMPTY } else { NULL });
            repetitions.push(0);
        }
        definitions.extend(items.iter().map(|_| ITEM));
        repetitions.extend((0..items.len()).map(|i| i16::from(i > 0)));
        values.extend(items.iter().map(&convert));
    }
    out.typed::<T>().write_batch(&values, Some(&definitions), Some(&repetitions))?;
    Ok(())
}
