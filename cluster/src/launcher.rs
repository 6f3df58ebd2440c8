//! What the environment says of a launcher: whether this process is one of several, and which.
//!
//! It is known before MPI is initialised, and by programs that are built without it: those can say
//! that they are no use to whoever launched them.

/// What starts the ranks of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Launcher {
    /// How it lets its processes know who they are.
    pub name: &'static str,
    /// Which of them this is, from 0.
    pub rank: usize,
    /// How many it started, if it says so.
    pub size: Option<usize>,
}

impl Launcher {
    /// The launcher of this process, if it has one. `env` looks up a variable of the environment.
    ///
    /// A batch script is none: what it runs directly runs once, whatever Slurm says of its tasks.
    pub fn detect(env: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let number = |name: &str| env(name)?.parse().ok();
        let launchers = [
            ("Open MPI", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
            // MPICH, Intel MPI, and Slurm for both.
            ("PMI", "PMI_RANK", "PMI_SIZE"),
            // It has no variable for the size, but Slurm has one for each of its steps.
            ("PMIx", "PMIX_RANK", "SLURM_STEP_NUM_TASKS"),
        ];
        launchers.into_iter().find_map(|(name, rank, size)| {
            Some(Self { name, rank: number(rank)?, size: number(size) })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detect(env: &[(&str, &str)]) -> Option<Launcher> {
        let value = |name: &str| env.iter().find(|(found, _)| *found == name);
        Launcher::detect(|name| value(name).map(|(_, value)| (*value).to_owned()))
    }

    #[test]
    fn each_launcher_says_who_this_is() {
        let open_mpi = [("OMPI_COMM_WORLD_RANK", "3"), ("OMPI_COMM_WORLD_SIZE", "4")];
        let found = detect(&open_mpi);
        assert_eq!(found, Some(Launcher { name: "Open MPI", rank: 3, size: Some(4) }));
        let found = detect(&[("PMI_SIZE", "12"), ("PMI_RANK", "0")]);
        assert_eq!(found, Some(Launcher { name: "PMI", rank: 0, size: Some(12) }));
        let found = detect(&[("PMIX_RANK", "7"), ("SLURM_STEP_NUM_TASKS", "8")]);
        assert_eq!(found, Some(Launcher { name: "PMIx", rank: 7, size: Some(8) }));
        let found = detect(&[("PMIX_RANK", "7"), ("SLURM_NTASKS", "8")]);
        assert_eq!(found, Some(Launcher { name: "PMIx", rank: 7, size: None }));
        // Open MPI's own launcher sets this too, inside an allocation of Slurm as well.
        let all = [open_mpi[0], open_mpi[1], ("PMIX_RANK", "3"), ("SLURM_STEP_NUM_TASKS", "1")];
        assert_eq!(detect(&all), detect(&open_mpi));
    }

    #[test]
    fn a_batch_script_is_no_launcher() {
        assert_eq!(detect(&[]), None);
        let batch = [("SLURM_PROCID", "0"), ("SLURM_NTASKS", "16"), ("SLURM_STEP_NUM_TASKS", "1")];
        assert_eq!(detect(&batch), None);
        assert_eq!(detect(&[("OMPI_COMM_WORLD_SIZE", "4"), ("PMI_SIZE", "4")]), None);
    }

    #[test]
    fn what_is_no_number_is_not_there() {
        for rank in ["", "one", "-1", "1.5", "99999999999999999999999"] {
            assert_eq!(detect(&[("OMPI_COMM_WORLD_RANK", rank), ("PMI_RANK", rank)]), None);
        }
        let found = detect(&[("OMPI_COMM_WORLD_RANK", "x"), ("PMI_RANK", "1"), ("PMI_SIZE", "y")]);
        assert_eq!(found, Some(Launcher { name: "PMI", rank: 1, size: None }));
    }
}
