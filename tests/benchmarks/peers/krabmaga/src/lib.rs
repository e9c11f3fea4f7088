//! Turns: a line of the standard input asks for one, a line of JSON tells what it took.

use std::io::BufRead;

/// Seconds that this process has had of the processors.
pub fn processor() -> f64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut now) };
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// AGENTS and STEPS of the command line.
pub fn given() -> (usize, usize) {
    let words: Vec<usize> = std::env::args().skip(1).map(|word| word.parse().expect("a whole number")).collect();
    let [agents, steps] = words[..] else { panic!("AGENTS STEPS") };
    (agents, steps)
}

/// Take a turn for each line: seconds of a step, and neighbours in the mean if they matter.
pub fn turns(mut turn: impl FnMut() -> (f64, Option<f64>)) {
    for _ in std::io::stdin().lock().lines() {
        let (step, neighbours) = turn();
        let seen = neighbours.map_or("null".to_string(), |mean| format!("{mean:.2}"));
        println!("{{\"step\": {step:.9}, \"neighbours\": {seen}}}");
    }
}
