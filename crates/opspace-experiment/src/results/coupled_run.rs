//! Execution of an experiment with several robots: a log, a summary and a page for each robot and for all.

use crate::evaluate::coupled_summary::{CoupledEvaluator, CoupledSummary};
use crate::evaluate::metrics::Evaluator;
use crate::evaluate::summary::Summary;
use crate::report::coupled_page::coupled_page;
use crate::report::coupling_figures::coupling_figures;
use crate::report::document::RunSection;
use crate::report::figure::Figure;
use crate::results::folder::NewLog;
use crate::run::coupled_experiment::CoupledExperiment;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::result_files::{LOG, REPORT, ResultFolder, SUMMARY, write_file};
use opspace_backend::Backend;
use opspace_log::{LogFile, Recording, SegmentRecorder};
use std::cell::RefCell;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

impl CoupledExperiment {
    /// Runs the experiment in simulation in a folder that the caller has locked: the log, the summary and the page of each
    /// robot in a folder of its name, and a summary and a page of all. Existing logs are never overwritten.
    ///
    /// # Errors
    /// A robot that cannot be simulated; a folder that already holds a log; files that cannot be written.
    pub fn run_in_folder(
        &self,
        folder: &ResultFolder,
        progress: &Progress,
    ) -> Result<CoupledSummary, RunError> {
        let mut arms = self.simulated_arms()?;
        let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
        self.run_robots(&mut robots, folder, progress)
    }

    /// Runs the experiment on these robots, in their order, as [`run_in_folder`](Self::run_in_folder) does.
    pub(super) fn run_robots(
        &self,
        robots: &mut [&mut dyn Backend],
        folder: &ResultFolder,
        progress: &Progress,
    ) -> Result<CoupledSummary, RunError> {
        let mut folders = Vec::new();
        let mut logs = Vec::new();
        let mut files: Vec<Option<BufWriter<File>>> = Vec::new();
        for member in &self.members {
            let own = ResultFolder::open(&folder.path().join(&member.name))?;
            let (log, file) = match NewLog::create(&own) {
                Ok(created) => created,
                Err(error) => {
                    logs.into_iter().for_each(NewLog::discard);
                    return Err(error);
                }
            };
            folders.push(own);
            logs.push(log);
            files.push(Some(file));
        }
        let driven = self.drive_robots(robots, progress, |number, capabilities, truth| {
            let file =
                files[number].take().ok_or_else(|| RunError::Incomplete { what: "a log".to_owned() })?;
            self.members[number].experiment.open(capabilities, truth, file, progress)
        });
        let driven = match driven {
            Ok(driven) => driven,
            Err(error) => {
                logs.into_iter().for_each(NewLog::discard);
                return Err(error);
            }
        };
        let mut summaries = Vec::new();
        for (((member, own), log), (sink, outcome)) in self.members.iter().zip(&folders).zip(logs).zip(driven)
        {
            let written = sink.close(&member.experiment, outcome);
            summaries.push(member.experiment.finish_folder(own, log, written)?);
        }
        self.write_pages(folder.path(), summaries)
    }

    /// Runs the experiment in simulation without logs.
    ///
    /// # Errors
    /// A robot that cannot be simulated.
    pub fn run_without_logs(&self, progress: &Progress) -> Result<CoupledSummary, RunError> {
        let evaluators: Vec<RefCell<Evaluator<'_>>> =
            self.members.iter().map(|member| RefCell::new(Evaluator::new(&member.experiment))).collect();
        let coupled = RefCell::new(CoupledEvaluator::new(self));
        let driven = self.drive(progress, |number, capabilities, truth| {
            let member = &self.members[number].experiment;
            let (control, layouts) = member.loop_and_layouts(capabilities, truth)?;
            let (evaluators, coupled) = (&evaluators, &coupled);
            let receive = move |segment: &Recording, is_last: bool| {
                evaluators[number].borrow_mut().add(segment, is_last);
                coupled.borrow_mut().add(number, segment, is_last);
            };
            Ok((control, SegmentRecorder::new(layouts, receive)))
        })?;
        let mut outcomes = Vec::new();
        for (sink, outcome) in driven {
            sink.finish();
            outcomes.push(outcome);
        }
        let evaluated = evaluators.into_iter().map(RefCell::into_inner);
        let summaries =
            self.members.iter().zip(evaluated).zip(outcomes).map(|((member, evaluator), outcome)| {
                let record = member.experiment.outcome_record(&outcome);
                member.experiment.summary_of(&Recording::default(), evaluator.finish(), &record, None)
            });
        let summaries = summaries.collect();
        Ok(coupled.into_inner().finish(summaries))
    }

    /// Computes the summary of a run and the page about it from the logs and the summaries of the robots, in the order of
    /// `members`.
    ///
    /// # Errors
    /// A log that cannot be read.
    pub fn summary_and_page(
        &self,
        logs: &[LogFile],
        robots: Vec<Summary>,
    ) -> Result<(CoupledSummary, String), RunError> {
        let mut evaluator = CoupledEvaluator::new(self);
        let mut sections = Vec::new();
        for (number, ((member, log), robot)) in self.members.iter().zip(logs).zip(&robots).enumerate() {
            log.for_each_segment(&mut |segment, is_last| evaluator.add(number, segment, is_last))?;
            sections
                .push((member.name.clone(), RunSection::of_file(&member.experiment, log, robot.clone())?));
        }
        let figures: Vec<Figure> = evaluator.couplings.iter().flat_map(coupling_figures).collect();
        let summary = evaluator.finish(robots);
        let page = coupled_page(self, &summary, &figures, &sections);
        Ok((summary, page))
    }

    /// Writes summary and page of all robots.
    fn write_pages(&self, folder: &Path, robots: Vec<Summary>) -> Result<CoupledSummary, RunError> {
        let logs = self.members.iter().map(|member| LogFile::open(folder.join(&member.name).join(LOG)));
        let (mut summary, html) = self.summary_and_page(&logs.collect::<Result<Vec<_>, _>>()?, robots)?;
        if let Err(error) = write_file(&folder.join(REPORT), &html) {
            summary.not_saved.push(format!("{REPORT}: {error}"));
        }
        let path = folder.join(SUMMARY);
        let json = serde_json::to_string_pretty(&summary)
            .map_err(|error| RunError::Write { path: path.clone(), source: error.into() })?;
        if let Err(error) = write_file(&path, &(json + "\n")) {
            summary.not_saved.push(format!("{SUMMARY}: {error}"));
        }
        Ok(summary)
    }
}
