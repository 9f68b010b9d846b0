"""Files of other tools: sites, fleets and orders in; costs, parameters and orders out. One module a format."""
