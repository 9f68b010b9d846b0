"""A mission as legs with numbers: routes, speeds, steps."""

from missionsim import command_package

command_package(__name__)
