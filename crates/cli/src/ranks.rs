//! Processes that `mpirun` or `srun` has started to train together.

use srflow_train::TrainError;
use srflow_train::ranks::{Alone, Communicator, launched};

use crate::{Context, FAILED, fail};

/// The processes that train with this one.
///
/// # Errors
/// When there are several and they cannot exchange anything.
pub fn start() -> anyhow::Result<Box<dyn Communicator>> {
    let Some(launched) = launched(|name| std::env::var(name).ok()) else { return Ok(Box::new(Alone)) };
    #[cfg(feature = "mpi")]
    return Ok(Box::new(srflow_train::mpi::World::start(&launched)?));
    #[cfg(not(feature = "mpi"))]
    anyhow::bail!(
        "{} has started {} processes, and this srflow was built without MPI: each would train alone and write into one folder. Build \
         it with --features mpi (docs/training.md), or start one process",
        launched.launcher,
        launched.processes
    );
}

/// Ends all processes after an error, which the one that has it prints before any ends: launchers stop the others at the first that
/// fails.
pub fn exit_failed(communicator: Box<dyn Communicator>, error: &anyhow::Error, context: &Context) -> ! {
    let code = match error.downcast_ref() {
        Some(TrainError::OtherRank { .. }) => FAILED,
        Some(TrainError::Rank { .. }) => fail(error, context),
        // The others do not know of it, and would wait for this one.
        _ => communicator.abort(fail(error, context)),
    };
    drop(communicator);
    std::process::exit(code.into())
}
