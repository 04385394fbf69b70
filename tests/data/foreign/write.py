"""Writes passages.parquet beside this file from the first three passages of a recorded site, as another program might: identifiers of
64 bits, a dictionary of train types, loads as whole numbers, large lists of float64, a row group per row, pages of the second version
without dictionaries of values, and a null among the last row's samples.

    python3 write.py ../field/reference-2/passages.parquet      # pyarrow 18 or later
"""
import pathlib
import sys

import pyarrow as pa
import pyarrow.parquet as pq

table = pq.read_table(sys.argv[1]).slice(0, 3)
samples = [[float(a) for a in row] for row in table["acceleration_m_s2"].to_pylist()]
samples[2][7] = None
columns = {
    "passage_id": table["passage_id"].cast(pa.int64()),
    "train_type": table["train_type"].cast(pa.string()).dictionary_encode(),
    "axle_load_kg": table["axle_load_kg"].cast(pa.int64(), safe=False),
    "remark": pa.array(["kept", None, ""]),
    "speed_m_s": table["speed_m_s"],
    "temperature_c": table["temperature_c"],
    "sample_rate_hz": table["sample_rate_hz"].cast(pa.float32()),
    "acceleration_m_s2": pa.array(samples, pa.large_list(pa.float64())),
}
pq.write_table(
    pa.table(columns),
    pathlib.Path(__file__).with_name("passages.parquet"),
    row_group_size=1,
    data_page_version="2.0",
    compression="zstd",
    use_dictionary=["train_type"],
    use_byte_stream_split=["acceleration_m_s2"],
)
