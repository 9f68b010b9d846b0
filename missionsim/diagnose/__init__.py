"""From a robot and its logs to a verdict: which physical effect is missing, or what to drive to find out."""

from missionsim import command_package
from missionsim.diagnose.diagnosis import diagnose, diagnose_files
from missionsim.diagnose.examine import Subject
from missionsim.identify.findings import Diagnosis

__all__ = ["Diagnosis", "Subject", "diagnose", "diagnose_files"]

command_package(__name__)
