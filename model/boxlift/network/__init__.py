"""The monocular network in torch: backbones, heads, losses, training and export. Needs the extra `train`."""
