//! Recordings as text: index `passages.csv`, one file of samples per passage.
//!
//! The index has the scalar columns of `passages.parquet` and the column `file`, a path relative to the site
//! directory. An empty `speed_m_s` is a null. The sample file has a column `acceleration_m_s2` (`.csv`), or is a
//! MAT v5 or miniSEED file (see [`super::samples`]).

use std::path::{Component, Path, PathBuf};

use csv::{ByteRecord, ReaderBuilder, Trim};

use super::check::{Gate, MAX_PASSAGES};
use super::files::{quoted, read_bytes, write_atomic};
use super::samples::{self, Source};
use super::{Crossing, Passage, PassageFault, RecordingError, Skipped};

const INDEX: &str = "passages.csv";
const COLUMNS: [&str; 7] =
    ["passage_id", "train_type", "axle_load_kg", "speed_m_s", "temperature_c", "sample_rate_hz", "file"];
/// Optional: m/s² per count, for sample files that hold integers.
const SCALE: &str = "m_s2_per_count";

/// Reads the index and the files it names.
pub(super) fn read_passages(
    dir: &Path,
    crossing: &Crossing,
) -> Result<(Vec<Passage>, Vec<Skipped>), RecordingError> {
    let file = dir.join(INDEX);
    let rows = parse_index(&file, &read_bytes(&file)?)?;
    if rows.is_empty() {
        return Err(RecordingError::NoRows { file });
    }
    let mut gate = Gate::new(crossing, INDEX);
    for (row, cells) in rows.iter().enumerate() {
        gate.admit(row, cells.id().ok(), cells.passage(dir));
    }
    Ok((gate.passages, gate.skipped))
}

/// One row of the index.
struct Row {
    /// Text, in the order of [`COLUMNS`], then the scale.
    cells: [Option<String>; 8],
    /// Fields of the row and of the header: another number means that text stands in the wrong column.
    fields: [usize; 2],
}

fn parse_index(file: &Path, bytes: &[u8]) -> Result<Vec<Row>, RecordingError> {
    let damaged = |reason: String| RecordingError::Damaged { file: file.into(), reason };
    let mut reader = ReaderBuilder::new().trim(Trim::All).flexible(true).from_reader(bytes);
    let headers = reader.byte_headers().map_err(|e| damaged(e.to_string()))?.clone();
    let place = |name: &str| headers.iter().position(|h| h == name.as_bytes());
    let mut places = [None; 8];
    for (slot, column) in places.iter_mut().zip(COLUMNS) {
        *slot = Some(place(column).ok_or_else(|| missing(file, column, &headers))?);
    }
    places[7] = place(SCALE);
    let mut rows = Vec::new();
    for record in reader.byte_records() {
        let record = record.map_err(|e| damaged(e.to_string()))?;
        if rows.len() == MAX_PASSAGES {
            return Err(damaged(format!("more than {MAX_PASSAGES} rows")));
        }
        let text = |k: usize| String::from_utf8_lossy(record.get(k).unwrap_or_default()).into_owned();
        rows.push(Row {
            cells: places.map(|k| k.map(text).filter(|t| !t.is_empty())),
            fields: [record.len(), headers.len()],
        });
    }
    Ok(rows)
}

fn missing(file: &Path, column: &'static str, headers: &ByteRecord) -> RecordingError {
    let present = headers.iter().map(String::from_utf8_lossy).collect::<Vec<_>>().join(", ");
    RecordingError::MissingColumn { file: file.into(), column, present }
}

impl Row {
    fn text(&self, k: usize) -> Result<&str, PassageFault> {
        self.cells[k].as_deref().ok_or(PassageFault::Null { column: COLUMNS[k] })
    }

    fn parse<T: std::str::FromStr>(&self, k: usize) -> Result<T, PassageFault> {
        let text = self.text(k)?;
        text.parse().map_err(|_| PassageFault::NotANumber { column: COLUMNS[k], text: quoted(text) })
    }

    fn id(&self) -> Result<i32, PassageFault> {
        self.parse(0)
    }

    fn passage(&self, dir: &Path) -> Result<Passage, PassageFault> {
        let [found, expected] = self.fields;
        if found != expected {
            return Err(PassageFault::Fields { found, expected });
        }
        let sample_rate_hz = self.parse(5)?;
        let scale = self.cells[7].as_deref().map(|text| {
            text.parse().map_err(|_| PassageFault::NotANumber { column: SCALE, text: quoted(text) })
        });
        let source = Source {
            file: &sample_file(dir, self.text(6)?)?,
            sample_rate_hz,
            m_s2_per_count: scale.transpose()?,
        };
        Ok(Passage {
            passage_id: self.id()?,
            train_type: self.text(1)?.into(),
            axle_load_kg: self.parse(2)?,
            speed_m_s: self.cells[3].as_ref().map(|_| self.parse(3)).transpose()?,
            temperature_c: self.parse(4)?,
            sample_rate_hz,
            acceleration_m_s2: samples::read(&source)?,
        })
    }
}

/// A path from the index must stay inside the site directory.
fn sample_file(dir: &Path, text: &str) -> Result<PathBuf, PassageFault> {
    let path = Path::new(text);
    if path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
        Ok(dir.join(path))
    } else {
        Err(PassageFault::SampleFile {
            reason: format!("`{}` leads out of the site directory; give a path inside it", quoted(text)),
        })
    }
}

/// Writes the index and `passages/NNN.csv`. Sample files first: an index never names a missing file.
pub(super) fn write_passages(dir: &Path, passages: &[Passage]) -> Result<(), RecordingError> {
    let folder = dir.join("passages");
    std::fs::create_dir_all(&folder).map_err(|source| RecordingError::Io {
        doing: "create",
        path: folder.clone(),
        source,
    })?;
    let mut index = csv::Writer::from_writer(Vec::new());
    let failed =
        |e: csv::Error| RecordingError::Io { doing: "write", path: dir.join(INDEX), source: e.into() };
    index.write_record(COLUMNS).map_err(failed)?;
    for p in passages {
        let name = format!("passages/{:03}.csv", p.passage_id);
        write_atomic(&dir.join(&name), samples::to_csv(&p.acceleration_m_s2).as_bytes())?;
        let scalars = [p.axle_load_kg.to_string(), p.speed_m_s.map_or(String::new(), |v| v.to_string())];
        let [load, speed] = scalars;
        let (temperature, rate) = (p.temperature_c.to_string(), p.sample_rate_hz.to_string());
        let id = p.passage_id.to_string();
        index
            .write_record([&id, &p.train_type, &load, &speed, &temperature, &rate, &name])
            .map_err(failed)?;
    }
    let bytes = index.into_inner().map_err(|e| failed(e.into_error().into()))?;
    write_atomic(&dir.join(INDEX), &bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = parse_index(Path::new(INDEX), &bytes);
        }

        #[test]
        fn property_arbitrary_cells_never_panic(cells in proptest::collection::vec("[^\r\n]{0,12}", 7)) {
            let text = format!("{}\n{}\n", COLUMNS.join(","), cells.join(","));
            if let Ok(rows) = parse_index(Path::new(INDEX), text.as_bytes()) {
                for row in rows {
                    let _ = row.passage(Path::new("/nowhere"));
                }
            }
        }
    }

    /// One row with a comma too many had the whole site refused.
    #[test]
    fn regress_a_row_with_another_number_of_fields_is_one_passage() {
        let text = format!(
            "{}\n0,a,15500,45,20,4000,0.csv\n1,a, short,15500,45,20,4000,1.csv\n2,a\n",
            COLUMNS.join(",")
        );
        let rows = parse_index(Path::new(INDEX), text.as_bytes()).unwrap();
        let fault = |k: usize| rows[k].passage(Path::new("/nowhere")).unwrap_err();
        assert!(matches!(fault(0), PassageFault::SampleFile { .. }), "only its file is missing");
        assert!(matches!(fault(1), PassageFault::Fields { found: 8, expected: 7 }));
        assert!(matches!(fault(2), PassageFault::Fields { found: 2, expected: 7 }));
    }

    #[test]
    fn regress_path_out_of_the_site_is_refused() {
        assert!(sample_file(Path::new("/site"), "../other/000.csv").is_err());
        assert!(sample_file(Path::new("/site"), "/etc/passwd").is_err());
        assert!(sample_file(Path::new("/site"), "passages/000.csv").is_ok());
    }
}
