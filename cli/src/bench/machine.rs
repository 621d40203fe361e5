//! On which machine something was measured.

use serde_json::{Value, json};
use storage::ByteSize;

/// What a figure depends on besides the program.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Machine {
    /// Name of the processor.
    processor: Option<String>,
    /// Threads that run at once.
    cores: usize,
    /// RAM, in bytes.
    memory: Option<u64>,
}

impl Machine {
    /// This one, as far as it tells.
    pub fn this() -> Self {
        let read = |path| std::fs::read_to_string(path).unwrap_or_default();
        Machine {
            processor: field(&read("/proc/cpuinfo"), "model name").map(str::to_owned),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory: field(&read("/proc/meminfo"), "MemTotal").and_then(kibibytes),
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        let cores = format!("{} {}", self.cores, if self.cores == 1 { "core" } else { "cores" });
        let memory = self.memory.map_or("unknown RAM".into(), |bytes| format!("{} of RAM", ByteSize(bytes)));
        [self.processor.clone().unwrap_or_else(|| "unknown processor".into()), cores, memory].join(", ")
    }

    pub fn to_json(&self) -> Value {
        json!({ "processor": self.processor, "cores": self.cores, "memory_bytes": self.memory })
    }
}

/// The text behind `name:`, in a file of such lines.
fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim())
}

fn kibibytes(text: &str) -> Option<u64> {
    text.strip_suffix("kB")?.trim().parse::<u64>().ok().map(|number| number * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_the_kernels_files() {
        let text = "processor\t: 0\nmodel name\t: Some CPU @ 2: fast\nMemTotal:       24521364 kB\n";
        assert_eq!(field(text, "model name"), Some("Some CPU @ 2: fast"));
        assert_eq!(field(text, "MemTotal").and_then(kibibytes), Some(24_521_364 * 1024));
        assert_eq!((field(text, "MemFree"), kibibytes("12 MB")), (None, None));
        let machine = Machine { processor: None, cores: 1, memory: Some(24 << 30) };
        assert_eq!(machine.text(), "unknown processor, 1 core, 24 GiB of RAM");
    }
}
