//! `srflow train`, alone or as one of the processes that `mpirun` or `srun` has started.

use srflow::train::TrainJob;
use srflow::{Job, Report};
use srflow_train::TrainError;
use srflow_train::ranks::Communicator;

use crate::output::exit_stopped;
use crate::{Context, FAILED, fail, run};
#[cfg(not(feature = "mpi"))]
use srflow::wrong_settings;

/// Trains, and prints the report. With `mpi` the first process prints it.
///
/// # Errors
/// Those of the job, and when standard output cannot be written to.
pub fn train(job: &TrainJob, context: &Context) -> anyhow::Result<()> {
    if !job.mpi || job.print_config {
        return run::run(job, context);
    }
    let communicator = start()?;
    let result = run::watching(TrainJob::WHEN_STOPPED, |watch| job.train(&*communicator, watch));
    let result = result.and_then(|report| {
        if communicator.rank() == 0 {
            run::print(&report, context)?;
        }
        Ok(report.stopped())
    });
    if communicator.ranks() > 1
        && let Err(error) = &result
    {
        exit_failed(communicator, error, context);
    }
    drop(communicator);
    if result? { exit_stopped() } else { Ok(()) }
}

/// The processes that train with this one.
///
/// # Errors
/// When this program was built without MPI, or MPI does not know the processes.
fn start() -> anyhow::Result<Box<dyn Communicator>> {
    #[cfg(feature = "mpi")]
    return Ok(Box::new(srflow_train::mpi::World::start(|name| std::env::var(name).ok())?));
    #[cfg(not(feature = "mpi"))]
    wrong_settings!(
        "`mpi`: this srflow was built without MPI; build it with --features mpi (docs/guides/train.md)"
    );
}

/// Ends all processes after an error. The one that has it prints it before any ends, since launchers stop the others at the first that
/// fails.
fn exit_failed(communicator: Box<dyn Communicator>, error: &anyhow::Error, context: &Context) -> ! {
    let code = match error.downcast_ref() {
        Some(TrainError::OtherRank { .. }) => FAILED,
        Some(TrainError::Rank { .. }) => fail(error, context),
        // The others do not know of it, and would wait for this one.
        _ => communicator.abort(fail(error, context)),
    };
    drop(communicator);
    std::process::exit(code.into())
}
