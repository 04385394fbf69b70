//! Reading with limits: a few rows of the asked columns at a time.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_column_reader};
use parquet::data_type::{ByteArray, DataType};
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::{ChunkReader, FileReader, SerializedFileReader};

use super::layout::{Layout, layout};
use super::{Cells, Kind, List, Values};
use crate::recording::RecordingError;
use crate::recording::check::{MAX_PASSAGES, MAX_SAMPLES};
use crate::recording::guard::guarded;

/// Rows decoded at a time, and the bytes that they may take in the file's own form, as far as one row does not take more: long lists
/// need six times as much while they are taken apart.
const BATCH: (usize, u64) = (4, 32 << 20);
/// Values of a column that a batch may take, those of a page that reaches beyond it included. Runs of one value take next to no bytes in
/// the file and 40 each here.
const MOST_VALUES: u64 = 2 * BATCH.0 as u64 * MAX_SAMPLES as u64;
/// Largest decoded size of a file, bytes. A damaged or hostile footer may promise far more than the disk holds.
const MAX_DECODED_BYTES: i64 = 8 << 30;

/// Opens a Parquet file, checks its columns and hands over one batch after the other.
pub(crate) fn for_each_batch(
    file: &Path,
    columns: &[(&'static str, Kind)],
    use_batch: impl FnMut(&Cells) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let handle =
        File::open(file).map_err(|source| RecordingError::Io { doing: "open", path: file.into(), source })?;
    for_each_batch_of(file, handle, columns, use_batch)
}

/// Like [`for_each_batch`] for what is open already; `file` is for messages.
pub(crate) fn for_each_batch_of<R: ChunkReader + 'static>(
    file: &Path,
    content: R,
    columns: &[(&'static str, Kind)],
    mut use_batch: impl FnMut(&Cells) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let damaged = |reason: String| RecordingError::Damaged { file: file.into(), reason };
    let reader: Box<dyn FileReader> = Box::new(
        guarded(|| SerializedFileReader::new(content))
            .map_err(damaged)?
            .map_err(|e| damaged(e.to_string()))?,
    );
    let metadata = reader.metadata();
    let schema = metadata.file_metadata().schema_descr();
    let layouts = columns
        .iter()
        .map(|&(column, kind)| Ok((column, kind, layout(file, schema, column, kind)?)))
        .collect::<Result<Vec<_>, RecordingError>>()?;
    check_size(metadata).map_err(damaged)?;
    let mut rows = 0;
    for group in 0..metadata.num_row_groups() {
        let mut group =
            guarded(|| Group::open(reader.as_ref(), group, &layouts)).map_err(damaged)?.map_err(damaged)?;
        while let Some(cells) = guarded(|| group.batch()).map_err(damaged)?.map_err(damaged)? {
            rows += cells.rows();
            if rows > MAX_PASSAGES {
                return Err(damaged(format!("more than {MAX_PASSAGES} rows")));
            }
            use_batch(&cells)?;
        }
    }
    if rows == 0 { Err(RecordingError::NoRows { file: file.into() }) } else { Ok(()) }
}

/// Refuses a footer that promises more than a site can hold, before anything is allocated for it.
fn check_size(metadata: &ParquetMetaData) -> Result<(), String> {
    let rows = metadata.file_metadata().num_rows();
    if rows < 0 || rows > MAX_PASSAGES as i64 {
        return Err(format!("it announces {rows} rows"));
    }
    let mut bytes: i64 = 0;
    for (rows, column) in
        metadata.row_groups().iter().flat_map(|group| group.columns().iter().map(|c| (group.num_rows(), c)))
    {
        let (size, values) = (column.uncompressed_size(), column.num_values());
        if size < 0 || !(0..=MAX_DECODED_BYTES / 4).contains(&values) {
            return Err(format!("it announces {values} values in {size} bytes in one column"));
        }
        if values > rows.saturating_mul(MAX_SAMPLES as i64) {
            return Err(format!(
                "it announces {values} values in {rows} rows of one column, more than {MAX_SAMPLES} in each; one row is one train passage"
            ));
        }
        if column.data_page_offset() < 0 || column.compressed_size() < 0 {
            return Err("it announces a column before its beginning".into());
        }
        bytes = bytes.saturating_add(size);
    }
    if bytes > MAX_DECODED_BYTES { Err(format!("it announces {bytes} bytes of data")) } else { Ok(()) }
}

/// A row group that is being read.
struct Group {
    left: usize,
    /// Rows of a batch.
    batch: usize,
    columns: Vec<Leaf>,
}

struct Leaf {
    column: &'static str,
    kind: Kind,
    layout: Layout,
    reader: ColumnReader,
    fetched: Arc<Fetched>,
}

/// Values in the pages that a column has given for a batch.
#[derive(Default)]
struct Fetched {
    values: AtomicU64,
    /// Of the last page, which the next batch goes on with.
    last: AtomicU64,
}

impl Fetched {
    fn begin_batch(&self) {
        self.values.store(self.last.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    fn add(&self, page: u64) -> Result<(), ParquetError> {
        self.last.store(page, Ordering::Relaxed);
        if self.values.fetch_add(page, Ordering::Relaxed).saturating_add(page) > MOST_VALUES {
            return Err(ParquetError::General(format!(
                "it holds more than {MOST_VALUES} values in {} rows or one page; one row is one train passage",
                BATCH.0
            )));
        }
        Ok(())
    }
}

/// Pages of a column, as many as a batch may take: the footer may announce less than they hold, or all of it may be in one row.
struct Pages {
    pages: Box<dyn PageReader>,
    fetched: Arc<Fetched>,
}

impl Iterator for Pages {
    type Item = Result<Page, ParquetError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for Pages {
    fn get_next_page(&mut self) -> Result<Option<Page>, ParquetError> {
        let page = self.pages.get_next_page()?;
        if let Some(data) = page.as_ref().filter(|page| page.is_data_page()) {
            self.fetched.add(data.num_values().into())?;
        }
        Ok(page)
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>, ParquetError> {
        self.pages.peek_next_page()
    }

    fn skip_next_page(&mut self) -> Result<(), ParquetError> {
        self.pages.skip_next_page()
    }

    fn at_record_boundary(&mut self) -> Result<bool, ParquetError> {
        self.pages.at_record_boundary()
    }
}

impl Group {
    fn open(
        reader: &dyn FileReader,
        group: usize,
        layouts: &[(&'static str, Kind, Layout)],
    ) -> Result<Self, String> {
        let group = reader.get_row_group(group).map_err(|e| e.to_string())?;
        let rows = group.metadata().num_rows();
        let left = usize::try_from(rows).map_err(|_| format!("it announces {rows} rows in a group"))?;
        let bytes_per_row = group.metadata().total_byte_size().unsigned_abs() / (left as u64).max(1);
        let batch = (BATCH.1 / bytes_per_row.max(1)).clamp(1, BATCH.0 as u64) as usize;
        let columns = layouts
            .iter()
            .map(|&(column, kind, layout)| {
                let fetched = Arc::<Fetched>::default();
                let pages = group.get_column_page_reader(layout.leaf).map_err(|e| e.to_string())?;
                let pages = Box::new(Pages { pages, fetched: Arc::clone(&fetched) });
                let reader = get_column_reader(group.metadata().schema_descr().column(layout.leaf), pages);
                Ok(Leaf { column, kind, layout, reader, fetched })
            })
            .collect::<Result<_, String>>()?;
        Ok(Self { left, batch, columns })
    }

    /// The next rows; `None` after the last.
    fn batch(&mut self) -> Result<Option<Cells>, String> {
        let rows = self.left.min(self.batch);
        self.left -= rows;
        if rows == 0 {
            return Ok(None);
        }
        let columns = self
            .columns
            .iter_mut()
            .map(|leaf| {
                Ok((leaf.column, leaf.values(rows).map_err(|e| format!("column {}: {e}", leaf.column))?))
            })
            .collect::<Result<_, String>>()?;
        Ok(Some(Cells { rows, columns }))
    }
}

impl Leaf {
    fn values(&mut self, rows: usize) -> Result<Values, ParquetError> {
        let layout = self.layout;
        self.fetched.begin_batch();
        Ok(match (self.kind, &mut self.reader) {
            (Kind::Integer, ColumnReader::Int32ColumnReader(r)) => {
                Values::Integers(scalars(lists(r, layout, rows, |v| Ok(v.into()))?))
            }
            (Kind::Integer, ColumnReader::Int64ColumnReader(r)) => {
                Values::Integers(scalars(lists(r, layout, rows, Ok)?))
            }
            (Kind::Number, reader) => Values::Numbers(scalars(numbers(reader, layout, rows)?)),
            (Kind::Numbers, reader) => Values::NumberLists(numbers(reader, layout, rows)?),
            (Kind::Text, ColumnReader::ByteArrayColumnReader(r)) => {
                Values::Texts(scalars(lists(r, layout, rows, text)?))
            }
            (Kind::Texts, ColumnReader::ByteArrayColumnReader(r)) => {
                Values::TextLists(lists(r, layout, rows, text)?)
            }
            _ => return Err(other_type()),
        })
    }
}

fn other_type() -> ParquetError {
    ParquetError::General("its data have another type than the schema says".into())
}

fn text(bytes: ByteArray) -> Result<String, ParquetError> {
    bytes.as_utf8().map(str::to_string)
}

fn numbers(
    reader: &mut ColumnReader,
    layout: Layout,
    rows: usize,
) -> Result<Vec<Option<List<f64>>>, ParquetError> {
    match reader {
        ColumnReader::DoubleColumnReader(r) => lists(r, layout, rows, Ok),
        ColumnReader::FloatColumnReader(r) => lists(r, layout, rows, |v| Ok(v.into())),
        ColumnReader::Int32ColumnReader(r) => lists(r, layout, rows, |v| Ok(v.into())),
        ColumnReader::Int64ColumnReader(r) => lists(r, layout, rows, |v| Ok(v as f64)),
        _ => Err(other_type()),
    }
}

/// A cell of a column without lists is a list of one.
fn scalars<T>(lists: Vec<Option<List<T>>>) -> Vec<Option<T>> {
    lists.into_iter().map(|list| list.and_then(|mut items| items.pop().flatten())).collect()
}

/// The next rows of a column, each value converted.
fn lists<T: DataType, V>(
    reader: &mut ColumnReaderImpl<T>,
    layout: Layout,
    rows: usize,
    convert: impl Fn(T::T) -> Result<V, ParquetError>,
) -> Result<Vec<Option<List<V>>>, ParquetError> {
    let (mut definitions, mut repetitions, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let (read, _, levels) =
        reader.read_records(rows, Some(&mut definitions), Some(&mut repetitions), &mut values)?;
    if read != rows {
        return Err(ParquetError::EOF(format!("it ends {} rows early", rows - read)));
    }
    // Levels that are the same throughout are not written.
    definitions.resize(levels, layout.value);
    repetitions.resize(levels, 0);
    let mut values = values.into_iter();
    let mut lists: Vec<Option<List<V>>> = Vec::with_capacity(rows);
    for (definition, repetition) in definitions.into_iter().zip(repetitions) {
        if repetition == 0 {
            lists.push((definition >= layout.cell).then(Vec::new));
        }
        if let Some(Some(list)) = lists.last_mut()
            && definition >= layout.item
        {
            let value = if definition == layout.value { values.next() } else { None };
            list.push(value.map(&convert).transpose()?);
        }
    }
    if lists.len() == rows {
        Ok(lists)
    } else {
        Err(ParquetError::General("its levels contradict its rows".into()))
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use bytes::Bytes;
    use parquet::basic::Encoding;

    use super::*;
    use crate::recording::table::{Column, write_columns};

    /// A single row of two thousand million values, a few bytes long in the file, took all memory.
    #[test]
    fn regress_rows_longer_than_any_passage_are_refused_by_the_footer() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let of_rows = |lengths: &[usize]| {
            let cells = lengths.iter().map(|n| Some(Cow::Owned(vec![0.0_f32; *n]))).collect();
            write_columns(file.path(), &[("x", Column::SingleLists(cells))]).unwrap();
            let mut found = Vec::new();
            for_each_batch(file.path(), &[("x", Kind::Numbers)], |cells| {
                found.extend((0..cells.rows()).map(|i| cells.list("x", i).unwrap().len()));
                Ok(())
            })
            .map(|()| found)
        };
        let error = of_rows(&[MAX_SAMPLES + 1]).unwrap_err().to_string();
        assert!(error.contains("4000001 values in 1 rows") && error.contains("one train passage"), "{error}");
        // One long row beside others is a matter of that row.
        assert_eq!(of_rows(&[3, MAX_SAMPLES + 1, 0, 1, 2, 5]).unwrap(), [3, MAX_SAMPLES + 1, 0, 1, 2, 5]);
    }

    /// Pages that hold as many values as stated each.
    struct Runs(Vec<u32>);

    impl Iterator for Runs {
        type Item = Result<Page, ParquetError>;

        fn next(&mut self) -> Option<Self::Item> {
            self.get_next_page().transpose()
        }
    }

    impl PageReader for Runs {
        fn get_next_page(&mut self) -> Result<Option<Page>, ParquetError> {
            Ok(self.0.pop().map(|num_values| Page::DataPage {
                buf: Bytes::new(),
                num_values,
                encoding: Encoding::PLAIN,
                def_level_encoding: Encoding::RLE,
                rep_level_encoding: Encoding::RLE,
                statistics: None,
            }))
        }

        fn peek_next_page(&mut self) -> Result<Option<PageMetadata>, ParquetError> {
            Ok(None)
        }

        fn skip_next_page(&mut self) -> Result<(), ParquetError> {
            Ok(())
        }
    }

    /// The footer may announce few values, and the pages hold many.
    #[test]
    fn regress_pages_beyond_what_a_batch_may_take_are_refused() {
        let fetched = Arc::<Fetched>::default();
        let pages = |runs: Vec<u32>| {
            let (pages, fetched) = (Box::new(Runs(runs)), Arc::clone(&fetched));
            fetched.begin_batch();
            Pages { pages, fetched }.collect::<Result<Vec<Page>, _>>().map(|pages| pages.len())
        };
        let half = (MOST_VALUES / 2) as u32;
        assert_eq!(pages(vec![half, half]).unwrap(), 2);
        // The last page reaches into the next batch.
        assert_eq!(pages(vec![half]).unwrap(), 1);
        let error = pages(vec![half, 1]).unwrap_err().to_string();
        assert!(error.contains("32000000 values in 4 rows"), "{error}");
        assert!(pages(vec![u32::MAX]).is_err());
    }
}
