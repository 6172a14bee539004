//! The table of classified expressions.

use std::path::Path;

use srflow_files::write_atomically;

use super::classified::Seen;

/// Writes a row for each expression, with the probability of each class.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, classes: &[String], classified: &[Seen]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        const COLUMNS: [&str; 11] = [
            "source",
            "subject",
            "clip",
            "type",
            "onset",
            "apex",
            "offset",
            "onset_s",
            "class",
            "most_probable",
            "doubt",
        ];
        let probabilities = classes.iter().map(|class| format!("probability_{class}"));
        table.write_record(
            COLUMNS.map(str::to_owned).into_iter().chain(["truth".to_owned()]).chain(probabilities),
        )?;
        for (row, _) in classified {
            let text = |text: &Option<String>| text.clone().unwrap_or_default();
            let cells = [
                row.source.clone(),
                row.subject.clone(),
                row.clip.clone(),
                row.kind.map(|kind| kind.name().to_owned()).unwrap_or_default(),
                row.onset.to_string(),
                row.apex.to_string(),
                row.offset.to_string(),
                row.onset_seconds.map(|seconds| format!("{seconds:.3}")).unwrap_or_default(),
                text(&row.class),
                row.most_probable.clone(),
                text(&row.doubt),
                text(&row.truth),
            ];
            let shown = |probability: &f64| match probability.is_finite() {
                true => format!("{probability:.4}"),
                false => String::new(),
            };
            table.write_record(cells.into_iter().chain(row.probabilities.iter().map(shown)))?;
        }
        table.flush()
    })?)
}
