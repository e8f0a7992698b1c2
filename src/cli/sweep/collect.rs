//! `augnerf sweep collect`.

use std::path::PathBuf;

use clap::Args;

use crate::base::{Error, Result};
use crate::cli::progress::print;
use crate::draw::SVG_ALONE;
use crate::report::tables::table_terminal;
use crate::sweep::{SweepFolder, check_name};

use super::{How, RESULTS, RUNS, begun, collect, terminal_width};

#[derive(Args)]
pub struct CollectArguments {
    /// Folder of a sweep: runs/NAME, or what --out named
    folder: PathBuf,
    /// Folder for tables and figures [default: results/NAME of runs/NAME, otherwise FOLDER/results]
    #[arg(long, value_name = "DIR")]
    results: Option<PathBuf>,
    /// The sweep's name in tables [default: the folder's]
    #[arg(long)]
    name: Option<String>,
    /// Put rows side by side that differ in an uncontrolled setting, such as the code's revision, and mark them
    #[arg(long)]
    force: bool,
    /// Join seconds and memory to the tables
    #[arg(long)]
    with_timing: bool,
    /// Folder that the definition's scenes lie in
    #[arg(long, env = "AUGNERF_DATA", value_name = "DIR")]
    data_root: Option<PathBuf>,
}

impl CollectArguments {
    pub fn run(self) -> Result<()> {
        let folder = SweepFolder::new(&self.folder);
        let definition = folder.definition()?;
        let points = begun(&folder, self.data_root.as_deref())?;
        let path = std::path::absolute(&self.folder).map_err(|e| Error::unreadable(&self.folder, &e))?;
        let own = || path.file_name().map_or("sweep".into(), |name| name.to_string_lossy().into_owned());
        let name = self.name.clone().unwrap_or_else(own);
        check_name("the sweep's name", &name).map_err(Error::Config)?;
        let runs = path.parent().filter(|parent| parent.file_name().is_some_and(|name| name == RUNS));
        let results = self.results.clone().unwrap_or_else(|| match runs {
            Some(runs) => runs.with_file_name(RESULTS).join(&name),
            None => path.join(RESULTS),
        });
        let how = How { force: self.force, with_timing: self.with_timing };
        let table = collect((&folder, &definition, &points), &name, &results, how)?;
        print(&table_terminal(&table, terminal_width()))?;
        print(&format!("tables: {}", results.display()))?;
        SVG_ALONE.into_iter().try_for_each(print)
    }
}
