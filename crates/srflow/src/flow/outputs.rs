//! The destination of the flow.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use srflow_files::{FileKind, FlowFormat, create_folder, read_text, write_file};

use super::FlowJob;
use super::extra::ExtraOutput;
use super::frames::Source;
use crate::error::wrong_settings;
use crate::output::ensure_free;
use crate::video::is_video;

/// The flow files to write.
pub struct Outputs {
    flows: Flows,
    viz: Option<Viz>,
    /// Files, or folders when the flow goes into a folder.
    extra: Vec<(ExtraOutput, PathBuf)>,
    force: bool,
}

enum Flows {
    File(PathBuf),
    Folder(PathBuf, FlowFormat),
}

/// The destination of the colour pictures.
enum Viz {
    File(PathBuf),
    Folder(PathBuf),
    Video(PathBuf),
}

/// The files of one pair.
pub struct PairFiles {
    pub flow: PathBuf,
    pub viz: Option<PathBuf>,
    pub extra: Vec<(ExtraOutput, PlaneFiles)>,
}

/// The files of a plane.
pub struct PlaneFiles {
    pub npy: PathBuf,
    pub png: Option<PathBuf>,
}

impl PairFiles {
    fn all(&self) -> impl Iterator<Item = &Path> {
        let planes = self.extra.iter().flat_map(|(_, files)| [Some(&files.npy), files.png.as_ref()]);
        [Some(&self.flow), self.viz.as_ref()].into_iter().chain(planes).flatten().map(PathBuf::as_path)
    }
}

impl Outputs {
    /// Two frames and a name with an extension give a file; everything else gives a folder.
    ///
    /// # Errors
    /// When `out` or `viz` does not fit the frames.
    pub fn plan(job: &FlowJob, source: &Source) -> anyhow::Result<Self> {
        let two_files = matches!(source, Source::Files(files) if files.len() == 2 && job.frames.len() == 2);
        let is_file =
            two_files && !job.out.is_dir() && job.out.extension().is_some() && !ends_with_separator(&job.out);
        let (flows, viz) = if is_file { Self::file(job)? } else { Self::folder(job, source)? };
        let mut extra = Vec::new();
        for kind in ExtraOutput::ALL {
            let Some(path) = job.extra(kind) else { continue };
            if job.initial_flow.is_some() {
                wrong_settings!(
                    "`{}` does not go together with `initial_flow`: leave one of them out",
                    kind.name()
                );
            }
            if job.parameters.start.is_some() {
                wrong_settings!("`{}` does not go together with `start`: leave one of them out", kind.name());
            }
            let is_npy = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy"));
            if is_file && (!is_npy || path.is_dir()) {
                wrong_settings!(
                    "{}: two frames give one array: expected the name of a file ending in .npy",
                    path.display()
                );
            }
            if !is_file && !path.is_dir() && (is_npy || path.is_file()) {
                wrong_settings!("{}: {source} give a folder of .npy files, not one file", path.display());
            }
            extra.push((kind, path.to_owned()));
        }
        let outputs = Self { flows, viz, extra, force: job.force };
        let files = outputs.pair("frame");
        let mut names = HashSet::new();
        if let Some(twice) = files.all().find(|file| !names.insert(*file)) {
            let place = if is_file { twice } else { twice.parent().unwrap_or(twice) };
            wrong_settings!("{}: two outputs would overwrite each other here; rename one", place.display());
        }
        Ok(outputs)
    }

    fn file(job: &FlowJob) -> anyhow::Result<(Flows, Option<Viz>)> {
        if FlowFormat::from_path(&job.out).is_none() {
            let names = FlowFormat::ALL.map(FlowFormat::extension).join(", ");
            wrong_settings!(
                "{}: unknown flow format; the extension must be one of {names}",
                job.out.display()
            );
        }
        if let Some(viz) = &job.viz {
            let is_png = viz.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
            if !is_png || viz.is_dir() {
                wrong_settings!(
                    "{}: two frames give one picture: expected the name of a file ending in .png",
                    viz.display()
                );
            }
        }
        Ok((Flows::File(job.out.clone()), job.viz.clone().map(Viz::File)))
    }

    fn folder(job: &FlowJob, source: &Source) -> anyhow::Result<(Flows, Option<Viz>)> {
        if job.initial_flow.is_some() {
            wrong_settings!("`initial_flow` is for two frames and a file, not for a sequence");
        }
        let viz = job.viz.clone().map(|viz| if is_video(&viz) { Viz::Video(viz) } else { Viz::Folder(viz) });
        let pictures = match &viz {
            Some(Viz::Folder(folder)) => Some(folder),
            _ => None,
        };
        for folder in [Some(&job.out), pictures].into_iter().flatten() {
            let like_file = folder.is_file() || FlowFormat::from_path(folder).is_some();
            if like_file && !folder.is_dir() {
                wrong_settings!("{}: {source} give a folder of flow files, not one file", folder.display());
            }
        }
        if let Source::Files(files) = source {
            let mut names = HashSet::new();
            for file in &files[..files.len() - 1] {
                ensure!(
                    names.insert(file.file_stem()),
                    "{}: another frame has the same name, and their flows would overwrite each other; rename one",
                    file.display()
                );
            }
        }
        Ok((Flows::Folder(job.out.clone(), job.format), viz))
    }

    /// The files of the pair whose first frame has this name.
    pub fn pair(&self, stem: &str) -> PairFiles {
        let named = |folder: &Path, extension: &str| folder.join(format!("{stem}.{extension}"));
        PairFiles {
            flow: match &self.flows {
                Flows::File(file) => file.clone(),
                Flows::Folder(folder, format) => named(folder, format.extension()),
            },
            viz: match &self.viz {
                Some(Viz::File(file)) => Some(file.clone()),
                Some(Viz::Folder(folder)) => Some(named(folder, "png")),
                Some(Viz::Video(_)) | None => None,
            },
            extra: self.extra.iter().map(|(kind, path)| (*kind, self.plane(path, stem))).collect(),
        }
    }

    /// The files of a plane of the pair whose first frame has this name; `path` as given.
    fn plane(&self, path: &Path, stem: &str) -> PlaneFiles {
        let npy = match self.flows {
            Flows::File(_) => path.to_owned(),
            Flows::Folder(..) => path.join(format!("{stem}.npy")),
        };
        PlaneFiles { png: self.viz.is_some().then(|| npy.with_extension("png")), npy }
    }

    /// The file of landmarks that are found.
    pub fn landmarks(&self) -> PathBuf {
        match &self.flows {
            Flows::File(file) => file.with_extension("landmarks.csv"),
            Flows::Folder(folder, _) => folder.join("landmarks.csv"),
        }
    }

    /// The video of the colours, if requested.
    pub fn video(&self) -> Option<&Path> {
        match &self.viz {
            Some(Viz::Video(file)) => Some(file),
            _ => None,
        }
    }

    /// Creates the folders, and returns how many pairs an interrupted run of the same identity has finished:
    /// none if they go into one file, or if each flow depends on the previous ones (`one_by_one`). A run into
    /// a folder keeps its identity there until [`finish`](Self::finish).
    ///
    /// # Errors
    /// When a folder cannot be created; without such a run, when a file of a pair exists and `force` is not
    /// set.
    pub fn claim(&mut self, identity: &str, source: &Source, one_by_one: bool) -> anyhow::Result<u64> {
        let Some(note) = self.note() else {
            self.prepare(&source.stems())?;
            return Ok(0);
        };
        let found = if self.force { None } else { read_text(&note, FileKind::Settings).ok() };
        if found.as_deref() != Some(identity) {
            let prepared = self.prepare(&source.stems());
            match found {
                // Earlier versions wrote other text than JSON.
                Some(text) if !text.starts_with('{') => prepared.with_context(|| {
                    format!(
                        "{}: an earlier version of srflow began this run, and this one cannot continue it",
                        note.display()
                    )
                })?,
                _ => prepared?,
            }
            write_file(&note, identity)?;
            return Ok(0);
        }
        self.force = true; // existing files belong to this run
        self.prepare(&[])?;
        if one_by_one || self.video().is_some() {
            return Ok(0);
        }
        let whole = |stem: &String| self.pair(stem).all().all(Path::is_file);
        Ok(source.all_stems().take_while(whole).count() as u64)
    }

    /// Marks the run as finished: every file is written.
    pub fn finish(&self) -> anyhow::Result<()> {
        match self.note() {
            Some(note) => fs::remove_file(&note).with_context(|| note.display().to_string()),
            None => Ok(()),
        }
    }

    /// The file that keeps a run's identity.
    fn note(&self) -> Option<PathBuf> {
        match &self.flows {
            Flows::Folder(folder, _) => Some(folder.join(".srflow-flow")),
            Flows::File(_) => None,
        }
    }

    /// Creates the folders.
    ///
    /// # Errors
    /// When a folder cannot be created, or a file of one of these pairs exists and `force` is not set.
    fn prepare(&self, stems: &[String]) -> anyhow::Result<()> {
        self.check_free(self.video().map(Path::to_owned))?;
        for stem in stems {
            self.check_pair(stem)?;
        }
        let files = self.pair("frame");
        for folder in files.all().chain(self.video()).filter_map(Path::parent) {
            if !folder.as_os_str().is_empty() {
                create_folder(folder)?;
            }
        }
        Ok(())
    }

    /// # Errors
    /// When a file of the pair exists and `force` is not set.
    pub fn check_pair(&self, stem: &str) -> anyhow::Result<()> {
        self.check_free(self.pair(stem).all().map(Path::to_owned))
    }

    fn check_free(&self, files: impl IntoIterator<Item = PathBuf>) -> anyhow::Result<()> {
        ensure_free(files, self.force)
    }
}

fn ends_with_separator(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}
