//! Which processors a worker is bound to: CPUs of its own, inside one NUMA node.
//!
//! Memory of another node is slower, and a thread that moves leaves its caches behind. The logic
//! works on a [`Topology`], so that tests can make one up; only [`Topology::detect`] asks the
//! system.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::ops::RangeInclusive;
use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why workers cannot be bound to processors.
#[derive(Debug, Error)]
pub enum AffinityError {
    /// The system has no way to bind a thread.
    #[error("binding workers to CPUs needs Linux")]
    Unsupported,
    /// A worker of no threads.
    #[error("a worker needs at least 1 thread, not 0")]
    NoThreads,
    /// Fewer CPUs than threads.
    #[error(
        "{workers} workers of {threads} threads need a CPU for each thread, and this process may \
         use {cpus} CPUs"
    )]
    TooFew {
        /// Number of workers.
        workers: usize,
        /// Threads of each worker.
        threads: usize,
        /// CPUs that this process may use.
        cpus: usize,
    },
    /// No node has enough CPUs for one worker.
    #[error("a worker of {threads} threads fits into no NUMA node: the largest has {cpus} CPUs")]
    NodeTooSmall {
        /// Threads of each worker.
        threads: usize,
        /// CPUs of the largest node that this process may use.
        cpus: usize,
    },
    /// Enough CPUs, but not enough of them side by side.
    #[error(
        "{workers} workers of {threads} threads do not fit: a worker stays inside one NUMA node, \
         and the nodes hold {room} such workers"
    )]
    Split {
        /// Number of workers.
        workers: usize,
        /// Threads of each worker.
        threads: usize,
        /// Workers that fit.
        room: usize,
    },
    /// A CPU whose number the system's interface has no bit for.
    #[error("cannot bind to CPU {cpu}: CPUs are numbered below {limit}")]
    Number {
        /// The CPU.
        cpu: usize,
        /// The first number that is too large.
        limit: usize,
    },
    /// The system refused.
    #[error("cannot {what}: {error}")]
    System {
        /// What was tried.
        what: String,
        /// What the system reports.
        error: io::Error,
    },
}

/// The processors that a worker is bound to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Processors {
    /// Number of the NUMA node, as the system counts.
    pub node: usize,
    /// Numbers of the CPUs, ascending, as the system counts.
    pub cpus: Vec<usize>,
}

impl Processors {
    /// Binds the calling thread to the CPUs. Threads that it starts later inherit that.
    ///
    /// # Errors
    /// CPUs that this process may not use, or another system than Linux.
    pub fn bind(&self) -> Result<(), AffinityError> {
        system::set_allowed(&self.cpus)
            .map_err(|error| error.while_trying(|| format!("bind a thread to {self}")))
    }
}

/// For example `node 0, cpus 0-1,4`.
impl fmt::Display for Processors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}, cpus ", self.node)?;
        for (index, run) in self.cpus.chunk_by(|a, b| a.checked_add(1) == Some(*b)).enumerate() {
            let comma = if index > 0 { "," } else { "" };
            match run {
                [first, .., last] => write!(f, "{comma}{first}-{last}")?,
                [only] => write!(f, "{comma}{only}")?,
                [] => (),
            }
        }
        Ok(())
    }
}

/// Runs `work` with the calling thread bound to `processors`, and then lets the thread run where
/// it did before.
///
/// Memory lies on the node of the thread that first writes to it. Threads of a pool that exists
/// already are not bound.
///
/// # Errors
/// As [`Processors::bind`]; then `work` has not run.
pub fn with_bound<T>(
    processors: &Processors,
    work: impl FnOnce() -> T,
) -> Result<T, AffinityError> {
    /// Also a `work` that panics leaves the thread as it was.
    struct Restore(Vec<usize>);
    impl Drop for Restore {
        fn drop(&mut self) {
            // Fails only if the CPUs were taken from this process meanwhile; then the system
            // has chosen others.
            let _ = system::set_allowed(&self.0);
        }
    }
    let _restore = Restore(system::allowed()?);
    processors.bind()?;
    Ok(work())
}

/// Processors for `workers` workers of `threads` threads on this machine; see
/// [`Topology::assign`].
///
/// # Errors
/// As [`Topology::detect`] and [`Topology::assign`].
pub fn assign(workers: usize, threads: usize) -> Result<Vec<Processors>, AffinityError> {
    Topology::detect()?.assign(workers, threads)
}

/// The CPUs that this process may use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topology {
    nodes: Vec<Node>,
}

/// The CPUs of a NUMA node that this process may use.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Node {
    number: usize,
    /// CPUs that share a core stand together.
    cores: Vec<Vec<usize>>,
}

impl Topology {
    /// What the system says about this machine and this process. A system that says nothing about
    /// nodes has one.
    ///
    /// # Errors
    /// Another system than Linux, or one that does not say which CPUs this process may use.
    pub fn detect() -> Result<Self, AffinityError> {
        Ok(Self::read(Path::new("/sys/devices/system"), &system::allowed()?))
    }

    /// The machine that the files below `folder` describe, of which only `allowed` may be used.
    fn read(folder: &Path, allowed: &[usize]) -> Self {
        let core = |cpu: usize| {
            let file = folder.join(format!("cpu/cpu{cpu}/topology/thread_siblings_list"));
            let siblings = fs::read_to_string(file).ok().and_then(|text| parse_list(&text));
            // The first of the siblings stands for the core.
            siblings.and_then(|list| list.first().map(|run| *run.start())).unwrap_or(cpu)
        };
        let group = |number: usize, cpus: &mut dyn Iterator<Item = usize>| {
            let mut cores = BTreeMap::<usize, Vec<usize>>::new();
            cpus.for_each(|cpu| cores.entry(core(cpu)).or_default().push(cpu));
            Node { number, cores: cores.into_values().collect() }
        };
        let entries = fs::read_dir(folder.join("node")).into_iter().flatten().flatten();
        let mut nodes: Vec<Node> = entries
            .filter_map(|entry| {
                let number = entry.file_name().to_str()?.strip_prefix("node")?.parse().ok()?;
                let list = parse_list(&fs::read_to_string(entry.path().join("cpulist")).ok()?)?;
                let of_node = |cpu: &usize| list.iter().any(|run| run.contains(cpu));
                Some(group(number, &mut allowed.iter().copied().filter(of_node)))
            })
            // Nodes of memory alone, or of CPUs that others use.
            .filter(|node| !node.cores.is_empty())
            .collect();
        nodes.sort_by_key(|node| node.number);
        if nodes.is_empty() {
            nodes.push(group(0, &mut allowed.iter().copied()));
        }
        Self { nodes }
    }

    /// Processors for each of `workers` workers of `threads` threads, in the order of workers.
    ///
    /// The workers are spread evenly over the nodes, and neighbouring workers share a node. Inside
    /// a node each gets an equal share of the cores, and of these one CPU per core as long as there
    /// are enough.
    ///
    /// # Errors
    /// Too few CPUs, also inside the nodes, or workers of no threads.
    pub fn assign(&self, workers: usize, threads: usize) -> Result<Vec<Processors>, AffinityError> {
        if threads == 0 {
            return Err(AffinityError::NoThreads);
        }
        let cpus: usize = self.nodes.iter().map(Node::cpus).sum();
        if workers.saturating_mul(threads) > cpus {
            return Err(AffinityError::TooFew { workers, threads, cpus });
        }
        let room: usize = self.nodes.iter().map(|node| node.cpus() / threads).sum();
        if room < workers {
            let largest = self.nodes.iter().map(Node::cpus).max().unwrap_or(0);
            return Err(if room == 0 {
                AffinityError::NodeTooSmall { threads, cpus: largest }
            } else {
                AffinityError::Split { workers, threads, room }
            });
        }
        let mut counts = vec![0_usize; self.nodes.len()];
        for _ in 0..workers {
            // The node with the fewest workers, then the one with the most CPUs left.
            let left = |index: usize| self.nodes[index].cpus() - counts[index] * threads;
            let next = (0..counts.len())
                .filter(|&index| left(index) >= threads)
                .min_by_key(|&index| (counts[index], usize::MAX - left(index)));
            if let Some(index) = next {
                counts[index] += 1;
            }
        }
        let nodes = self.nodes.iter().zip(counts);
        Ok(nodes.flat_map(|(node, count)| node.assign(count, threads)).collect())
    }
}

impl Node {
    fn cpus(&self) -> usize {
        self.cores.iter().map(Vec::len).sum()
    }

    /// Processors for `count` workers, which must fit.
    fn assign(&self, count: usize, threads: usize) -> Vec<Processors> {
        let cpus = self.cpus();
        // Each CPU with its number inside its core, core after core.
        let all: Vec<(usize, usize)> =
            self.cores.iter().flat_map(|core| core.iter().copied().enumerate()).collect();
        (0..count)
            .map(|index| {
                let mut share = all[index * cpus / count..(index + 1) * cpus / count].to_vec();
                // Stable, so the order of the cores stays.
                share.sort_by_key(|&(sibling, _)| sibling);
                let mut cpus: Vec<usize> =
                    share.into_iter().take(threads).map(|(_, cpu)| cpu).collect();
                cpus.sort_unstable();
                Processors { node: self.number, cpus }
            })
            .collect()
    }
}

/// The numbers of a list such as `0-3,8-11`, as the system writes them. An empty list is one.
fn parse_list(text: &str) -> Option<Vec<RangeInclusive<usize>>> {
    let text = text.trim();
    if text.is_empty() {
        return Some(Vec::new());
    }
    text.split(',')
        .map(|run| {
            let (first, last) = run.split_once('-').unwrap_or((run, run));
            let (first, last) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
            (first <= last).then_some(first..=last)
        })
        .collect()
}

impl AffinityError {
    /// The error of the system with what was tried.
    fn while_trying(self, what: impl FnOnce() -> String) -> Self {
        match self {
            Self::System { error, .. } => Self::System { what: what(), error },
            other => other,
        }
    }
}

/// The CPUs that the calling thread may use.
#[cfg(target_os = "linux")]
mod system {
    use super::AffinityError;
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

    /// Their numbers, ascending.
    pub fn allowed() -> Result<Vec<usize>, AffinityError> {
        let set = sched_getaffinity(None).map_err(|error| AffinityError::System {
            what: "ask which CPUs this process may use".to_owned(),
            error: error.into(),
        })?;
        Ok((0..CpuSet::MAX_CPU).filter(|&cpu| set.is_set(cpu)).collect())
    }

    /// From now on these.
    pub fn set_allowed(cpus: &[usize]) -> Result<(), AffinityError> {
        let mut set = CpuSet::new();
        for &cpu in cpus {
            if cpu >= CpuSet::MAX_CPU {
                return Err(AffinityError::Number { cpu, limit: CpuSet::MAX_CPU });
            }
            set.set(cpu);
        }
        sched_setaffinity(None, &set).map_err(|error| AffinityError::System {
            what: "bind a thread to CPUs".to_owned(),
            error: error.into(),
        })
    }
}

/// Other systems than Linux give hints at best.
#[cfg(not(target_os = "linux"))]
mod system {
    use super::AffinityError;

    pub fn allowed() -> Result<Vec<usize>, AffinityError> {
        Err(AffinityError::Unsupported)
    }

    pub fn set_allowed(_cpus: &[usize]) -> Result<(), AffinityError> {
        Err(AffinityError::Unsupported)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Nodes of so many cores of so many CPUs, all numbered through.
    fn topology(nodes: &[usize], siblings: usize) -> Topology {
        let mut next = 0;
        let node = |(number, &cores): (usize, &usize)| Node {
            number,
            cores: (0..cores)
                .map(|_| {
                    next += siblings;
                    (next - siblings..next).collect()
                })
                .collect(),
        };
        Topology { nodes: nodes.iter().enumerate().map(node).collect() }
    }

    fn shown(topology: &Topology, workers: usize, threads: usize) -> Vec<String> {
        topology.assign(workers, threads).unwrap().iter().map(Processors::to_string).collect()
    }

    fn refused(topology: &Topology, workers: usize, threads: usize) -> String {
        topology.assign(workers, threads).unwrap_err().to_string()
    }

    #[test]
    fn neighbours_share_a_node() {
        let two = topology(&[4, 4], 1);
        let full = ["node 0, cpus 0-1", "node 0, cpus 2-3", "node 1, cpus 4-5", "node 1, cpus 6-7"];
        assert_eq!(shown(&two, 4, 2), full);
        assert_eq!(shown(&two, 2, 3), ["node 0, cpus 0-2", "node 1, cpus 4-6"]);
        assert_eq!(shown(&two, 0, 3), [""; 0]);
        let uneven = topology(&[2, 6], 1);
        assert_eq!(
            shown(&uneven, 3, 2),
            ["node 0, cpus 0-1", "node 1, cpus 2-3", "node 1, cpus 5-6"]
        );
        assert_eq!(shown(&uneven, 2, 3), ["node 1, cpus 2-4", "node 1, cpus 5-7"]);
    }

    #[test]
    fn a_worker_takes_whole_cores_last() {
        let two = topology(&[4], 2);
        assert_eq!(shown(&two, 1, 4), ["node 0, cpus 0,2,4,6"]);
        assert_eq!(shown(&two, 1, 5), ["node 0, cpus 0-2,4,6"]);
        assert_eq!(shown(&two, 2, 2), ["node 0, cpus 0,2", "node 0, cpus 4,6"]);
        assert_eq!(shown(&two, 2, 4), ["node 0, cpus 0-3", "node 0, cpus 4-7"]);
    }

    #[test]
    fn what_does_not_fit_is_refused_with_the_reason() {
        let two = topology(&[4, 4], 1);
        assert_eq!(
            refused(&two, 5, 2),
            "5 workers of 2 threads need a CPU for each thread, and this process may use 8 CPUs"
        );
        assert_eq!(
            refused(&two, 1, 5),
            "a worker of 5 threads fits into no NUMA node: the largest has 4 CPUs"
        );
        assert_eq!(
            refused(&topology(&[4, 5], 1), 3, 3),
            "3 workers of 3 threads do not fit: a worker stays inside one NUMA node, and the \
             nodes hold 2 such workers"
        );
        assert_eq!(refused(&two, 1, 0), "a worker needs at least 1 thread, not 0");
        assert!(refused(&two, usize::MAX, 2).contains("8 CPUs"));
    }

    #[test]
    fn a_machine_is_read_from_files() {
        let folder = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| {
            let file = folder.path().join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, text).unwrap();
        };
        let all = [0, 1, 2, 3, 5];
        assert_eq!(
            Topology::read(folder.path(), &all),
            Topology { nodes: vec![Node { number: 0, cores: all.map(|cpu| vec![cpu]).to_vec() }] }
        );
        write("node/node10/cpulist", "1,3,5-4294967295\n");
        write("node/node2/cpulist", "0,2,4\n");
        write("node/node3/cpulist", "\n");
        write("node/node4/cpulist", "6-7\n");
        write("node/node5/cpulist", "nonsense\n");
        write("node/possible", "0-9\n");
        write("cpu/cpu1/topology/thread_siblings_list", "1,3\n");
        write("cpu/cpu3/topology/thread_siblings_list", "1,3\n");
        let nodes = vec![
            Node { number: 2, cores: vec![vec![0], vec![2]] },
            Node { number: 10, cores: vec![vec![1, 3], vec![5]] },
        ];
        assert_eq!(Topology::read(folder.path(), &all), Topology { nodes });
    }

    proptest! {
        #[test]
        fn workers_are_apart_and_each_inside_a_node(
            nodes in proptest::collection::vec(0_usize..7, 0..5), siblings in 1_usize..4,
            workers in 0_usize..20, threads in 0_usize..9,
        ) {
            let topology = topology(&nodes, siblings);
            let Ok(assigned) = topology.assign(workers, threads) else {
                let room: usize =
                    nodes.iter().map(|n| (n * siblings).checked_div(threads).unwrap_or(0)).sum();
                prop_assert!(room < workers || threads == 0);
                return Ok(());
            };
            prop_assert_eq!(assigned.len(), workers);
            prop_assert!(assigned.is_sorted_by_key(|processors| processors.node));
            let mut seen = std::collections::BTreeSet::new();
            for processors in &assigned {
                prop_assert_eq!(processors.cpus.len(), threads);
                prop_assert!(processors.cpus.is_sorted());
                let node = &topology.nodes[processors.node];
                for cpu in &processors.cpus {
                    prop_assert!(node.cores.iter().flatten().any(|own| own == cpu));
                    prop_assert!(seen.insert(*cpu));
                }
            }
        }

        #[test]
        fn lists_come_back(numbers in proptest::collection::btree_set(0_usize..99, 0..20)) {
            let processors = Processors { node: 0, cpus: numbers.iter().copied().collect() };
            let text = processors.to_string();
            let list = parse_list(text.strip_prefix("node 0, cpus ").unwrap()).unwrap();
            prop_assert_eq!(list.into_iter().flatten().collect::<Vec<_>>(), processors.cpus);
        }

        #[test]
        fn no_list_does_harm(text in "[-0-9, \nx]{0,30}") {
            if let Some(list) = parse_list(&text) {
                prop_assert!(list.iter().all(|run| run.start() <= run.end()));
            }
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_bound_thread_is_let_go() {
        let before = system::allowed().unwrap();
        let one = assign(1, 1).unwrap().remove(0);
        assert_eq!(with_bound(&one, || system::allowed().unwrap()).unwrap(), one.cpus);
        assert_eq!(system::allowed().unwrap(), before);
        std::thread::spawn(move || {
            one.bind().unwrap();
            let child = std::thread::spawn(|| system::allowed().unwrap());
            assert_eq!(child.join().unwrap(), one.cpus);
        })
        .join()
        .unwrap();
        let nowhere = Processors { node: 0, cpus: vec![1023] };
        let text = with_bound(&nowhere, || ()).unwrap_err().to_string();
        assert!(text.starts_with("cannot bind a thread to node 0, cpus 1023: "), "{text}");
        assert!(Processors { node: 0, cpus: vec![usize::MAX] }.bind().is_err());
        assert_eq!(system::allowed().unwrap(), before);
    }
}
