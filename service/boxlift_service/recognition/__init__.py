"""POST /pointCloud/recognition: fetched sweeps, labelled per camera, merged."""
