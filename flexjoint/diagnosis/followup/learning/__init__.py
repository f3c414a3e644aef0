"""Laws without a name: the best smooth law of what no cause explains, kept where it holds on unseen data"""
