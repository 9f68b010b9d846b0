"""Files of any layout into logs: tables, ROS bags and ULog, by a map in YAML."""
